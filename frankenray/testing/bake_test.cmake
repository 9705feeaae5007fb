# cmake -DBUILD= -DSOURCE= -DPYTHON= -P bake_test.cmake: the Python example in a small size.
set(ENV{FRANKENRAY_RENDRIB} ${BUILD}/bin/rendrib)
set(place ${BUILD}/frankenray/baked)
file(MAKE_DIRECTORY ${place})
execute_process(COMMAND ${PYTHON} ${SOURCE}/examples/clients/bake_ao.py ${SOURCE}/examples/models/bunny.rib baked.rib
                        --samples 16 --library ${BUILD}/lib/libfrankenray.so.1
                WORKING_DIRECTORY ${place} RESULT_VARIABLE status OUTPUT_VARIABLE out ERROR_VARIABLE err)
if(NOT status EQUAL 0)
  message(FATAL_ERROR "${status}\n${out}${err}")
endif()
# Most of a bunny sees between a third and all of the sky; what stands on the ground sees none.
if(NOT out MATCHES "1839 vertices, 16 rays each: open 0\\.0.* \\.\\.\\. (0\\.9|1\\.0).*, mean 0\\.[456]")
  message(FATAL_ERROR "not the occlusion of a bunny on the ground: ${out}")
endif()
file(READ ${place}/baked.rib baked)
if(NOT baked MATCHES "\"vertex color Cs\"")
  message(FATAL_ERROR "no colors in the baked mesh")
endif()
