# cmake -DBUILD= -DSOURCE= -DCC= -DSANITIZE= -DLIBDIR= -P install_test.cmake
set(place ${BUILD}/frankenray/installed)
file(REMOVE_RECURSE ${place})
file(MAKE_DIRECTORY ${place}/trial)

# run(<words>): fails the test when the program does; its output is in `out`.
function(run)
  execute_process(COMMAND ${ARGV} WORKING_DIRECTORY ${place}/trial RESULT_VARIABLE status OUTPUT_VARIABLE out
                  ERROR_VARIABLE err)
  if(NOT status EQUAL 0)
    message(FATAL_ERROR "${ARGV}: ${status}\n${out}${err}")
  endif()
  set(out "${out}" PARENT_SCOPE)
endfunction()

# ---- What the shared objects need: the C library alone ----
if(NOT SANITIZE)
  foreach(object IN ITEMS ${BUILD}/lib/libfrankenray.so.1 ${BUILD}/lib/frankenrender/shadeops/rayserver.so)
    run(readelf -d ${object})
    string(REGEX MATCHALL "NEEDED[^\n]*" needed "${out}")
    foreach(line IN LISTS needed)
      if(NOT line MATCHES "\\[(libc|libm|libpthread|libdl|librt|ld-linux[-_a-z0-9]*)\\.so")
        message(FATAL_ERROR "${object} must not bring anything into its host: ${line}")
      endif()
    endforeach()
    run(nm -D --defined-only ${object})
    string(REGEX REPLACE "\n" ";" lines "${out}")
    foreach(line IN LISTS lines)
      if(NOT line MATCHES " (frankenray_[a-z_]+@@FRANKENRAY_1|FRANKENRAY_1|[a-z]+_shadeops|rayserver_[a-z_0-9]+)$" AND
         NOT line STREQUAL "")
        if(NOT line MATCHES " A FRANKENRAY_1")
          message(FATAL_ERROR "${object} exports ${line}")
        endif()
      endif()
    endforeach()
  endforeach()
endif()

# ---- The example, built against an installation ----
run(${CMAKE_COMMAND} --install ${BUILD} --component frankenray --prefix ${place})
file(WRITE ${place}/trial/scene.rib "Projection \"perspective\"\nTranslate 0 0 10\nWorldBegin\n"
     "Polygon \"P\" [-9 -9 2  -9 9 2  9 9 2  9 -9 2]\nWorldEnd\n")
set(arguments scene.rib depth.pgm 0 0 -3 0 0 0 16 16)
set(ENV{FRANKENRAY_RENDRIB} ${BUILD}/bin/rendrib)

function(check program)
  run(${program} ${arguments})
  if(NOT out MATCHES "256 rays" OR NOT out MATCHES "nearest 5\\.0")
    message(FATAL_ERROR "${program} said ${out}")
  endif()
endfunction()

set(ENV{PKG_CONFIG_PATH} ${place}/${LIBDIR}/pkgconfig)
run(pkg-config --cflags --libs frankenray)
string(STRIP "${out}" flags)
separate_arguments(flags UNIX_COMMAND "${flags}")
set(sanitize "")
if(SANITIZE)
  set(sanitize -fsanitize=${SANITIZE})
endif()
run(${CC} -std=c99 -pedantic -Wall -Wextra -Werror ${sanitize} ${SOURCE}/examples/clients/depthmap.c ${flags} -lm
    -Wl,-rpath,${place}/${LIBDIR} -o depthmap)
check(./depthmap)

run(${CMAKE_COMMAND} -G Ninja -S ${SOURCE}/examples/clients -B cmake -DCMAKE_PREFIX_PATH=${place} -DCMAKE_C_COMPILER=${CC}
    -DCMAKE_C_FLAGS=${sanitize})
run(${CMAKE_COMMAND} --build cmake)
check(cmake/depthmap)

if(NOT EXISTS ${place}/share/man/man3/frankenray.3)
  message(FATAL_ERROR "no manual page")
endif()

# ---- rayserver.h: macros for others, nothing for us ----
file(WRITE ${place}/trial/shader.sl "#include \"rayserver.h\"
color a = Kr * trace(P, normalize(I)) * 2; float b = rayhittest(P, I, Phit, Nhit); float c = raylevel();
color d = visibility(P, L);
")
set(header ${place}/${LIBDIR}/frankenrender/shadeops)
run(${CC} -E -P -x c -I${header} shader.sl)
string(REGEX REPLACE "[ \n]+" "" tight "${out}")
foreach(part IN ITEMS
    "a=Kr*(colorrayserver_trace(pointtransform(\"world\",point(P)),vectorvtransform(\"world\",vector(normalize(I)))))*2;"
    "vector(I)),Phit,Nhit,pointtransform(\"world\",\"current\",point(0,0,0)),vectorvtransform(\"world\",\"current\",vector(1,0,0))"
    "c=0;" "d=(colorrayserver_visibility(pointtransform(\"world\",point(P)),pointtransform(\"world\",point(L))));")
  string(FIND "${tight}" "${part}" at)
  if(at EQUAL -1)
    message(FATAL_ERROR "rayserver.h: ${part} is not in ${out}")
  endif()
endforeach()
run(${CC} -E -P -x c -DFRANKENRENDER=1 -I${header} shader.sl)
if(NOT out MATCHES "Kr \\* trace\\(P, normalize\\(I\\)\\) \\* 2")
  message(FATAL_ERROR "rayserver.h defines something under frankenrender: ${out}")
endif()
