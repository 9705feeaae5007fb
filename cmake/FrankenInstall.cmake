# Filled as installable parts appear; see tools/CMakeLists.txt and shaders/CMakeLists.txt.
