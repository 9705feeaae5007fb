# OpenSubdiv's CPU library. Debian's own OpenSubdivConfig.cmake names static archives that its package
# does not ship, so it cannot be used. Defines Osd::osdCPU.
find_path(OSD_INCLUDE_DIR opensubdiv/far/topologyRefiner.h)
find_library(OSD_CPU_LIBRARY osdCPU)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(Osd REQUIRED_VARS OSD_CPU_LIBRARY OSD_INCLUDE_DIR)
if(Osd_FOUND AND NOT TARGET Osd::osdCPU)
  add_library(Osd::osdCPU UNKNOWN IMPORTED)
  set_target_properties(Osd::osdCPU PROPERTIES IMPORTED_LOCATION ${OSD_CPU_LIBRARY}
                        INTERFACE_INCLUDE_DIRECTORIES ${OSD_INCLUDE_DIR})
endif()
