# What `cmake --install` puts in place beside the programs and libraries (see fr_library, fr_program): headers under
# include/frankenrender, the CMake package under lib/cmake/frankenrender. Shaders and display drivers are installed by
# their own folders; programs find them relative to themselves.
include(CMakePackageConfigHelpers)

foreach(folder IN ITEMS base shm oracle ri scene_cache shading imaging tracer reyes)
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/${folder} DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/frankenrender
          FILES_MATCHING PATTERN "*.h" PATTERN "*.def")
endforeach()

set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/frankenrender)
install(EXPORT frankenrender FILE frankenrenderTargets.cmake NAMESPACE frankenrender:: DESTINATION ${package_dir})
# The C library alone, for find_package(frankenrender COMPONENTS frankenray): it needs nothing else of the package.
install(EXPORT frankenray FILE frankenrayTargets.cmake NAMESPACE frankenrender:: DESTINATION ${package_dir}
        COMPONENT frankenray)
configure_package_config_file(cmake/frankenrenderConfig.cmake.in
                              ${PROJECT_BINARY_DIR}/frankenrenderConfig.cmake INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/frankenrenderConfigVersion.cmake
                                 COMPATIBILITY SameMinorVersion)
file(GLOB find_modules ${PROJECT_SOURCE_DIR}/cmake/Find*.cmake)
install(FILES ${PROJECT_BINARY_DIR}/frankenrenderConfig.cmake
              ${PROJECT_BINARY_DIR}/frankenrenderConfigVersion.cmake ${find_modules}
        DESTINATION ${package_dir} COMPONENT frankenray)
install(FILES ${PROJECT_SOURCE_DIR}/LICENSE ${PROJECT_SOURCE_DIR}/README.md DESTINATION ${CMAKE_INSTALL_DOCDIR})
