# `cmake --build build/dev --target lint`: clang-format and clang-tidy over all sources. Needs clang-format, clang-tidy
# and Python, which nothing else here does, so the target exists only where they do.
find_package(Python3 QUIET COMPONENTS Interpreter)
find_program(FR_CLANG_FORMAT clang-format)
find_program(FR_CLANG_TIDY clang-tidy)
mark_as_advanced(FR_CLANG_FORMAT FR_CLANG_TIDY)
if(Python3_FOUND AND FR_CLANG_FORMAT AND FR_CLANG_TIDY AND CMAKE_EXPORT_COMPILE_COMMANDS)
  add_custom_target(lint COMMAND ${Python3_EXECUTABLE} ${PROJECT_SOURCE_DIR}/cmake/lint.py --build ${PROJECT_BINARY_DIR}
                    WORKING_DIRECTORY ${PROJECT_SOURCE_DIR} USES_TERMINAL VERBATIM)
endif()
