# The two interface targets that every target of ours links, and the functions that make targets.
#
#   fr_library(<name> SOURCES ... [DEPS ...] [PRIVATE_DEPS ...])
#   fr_program(<name> SOURCES ... [DEPS ...])
#   fr_test(<name> SOURCES ... [DEPS ...])       GoogleTest, main included
#   fr_isa_sources(<target> <file.cpp>)          one object per instruction set

add_library(fr_options INTERFACE)
target_compile_features(fr_options INTERFACE cxx_std_20)
target_include_directories(fr_options INTERFACE $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}>
                           $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}/frankenrender>)
# No contraction: shared edges and both processes must get the same bits from the same expression,
# wherever it was inlined.
target_compile_options(fr_options INTERFACE -ffp-contract=off -fno-math-errno -fno-trapping-math)

add_library(fr_warnings INTERFACE)
target_compile_options(fr_warnings INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Wconversion
                       -Wno-sign-conversion -Wnon-virtual-dtor -Woverloaded-virtual)
if(FR_WERROR)
  # GCC 12 raises these from inlined std::string code at -O3 where nothing is wrong: seen, but not fatal.
  target_compile_options(fr_warnings INTERFACE -Werror -Wno-error=restrict -Wno-error=maybe-uninitialized
                         -Wno-error=array-bounds -Wno-error=stringop-overflow -Wno-error=stringop-overread
                         -Wno-error=free-nonheap-object)
  # Clang does not know all of these names.
  target_compile_options(fr_warnings INTERFACE $<$<CXX_COMPILER_ID:Clang>:-Wno-unknown-warning-option>)
endif()

if(FR_SANITIZE)
  target_compile_options(fr_options INTERFACE -fsanitize=${FR_SANITIZE} -fno-omit-frame-pointer
                         -fno-sanitize-recover=all)
  target_link_options(fr_options INTERFACE -fsanitize=${FR_SANITIZE})
endif()

install(TARGETS fr_options fr_warnings EXPORT frankenrender)

function(fr_library name)
  cmake_parse_arguments(A "" "" "SOURCES;DEPS;PRIVATE_DEPS" ${ARGN})
  add_library(${name} STATIC ${A_SOURCES})
  set_target_properties(${name} PROPERTIES POSITION_INDEPENDENT_CODE ON CXX_EXTENSIONS OFF)
  target_link_libraries(${name} PUBLIC fr_options ${A_DEPS} PRIVATE fr_warnings ${A_PRIVATE_DEPS})
  if(NOT FR_FOR_DEVELOPERS)
    install(TARGETS ${name} EXPORT frankenrender ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR})
  endif()
endfunction()

function(fr_program name)
  cmake_parse_arguments(A "" "" "SOURCES;DEPS" ${ARGN})
  add_executable(${name} ${A_SOURCES})
  set_target_properties(${name} PROPERTIES CXX_EXTENSIONS OFF
                        RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/bin)
  target_compile_definitions(${name} PRIVATE FR_VERSION="${PROJECT_VERSION}")
  target_link_libraries(${name} PRIVATE fr_options fr_warnings ${A_DEPS})
  if(NOT FR_FOR_DEVELOPERS)  # benchmarks, fuzzers, parts of tests: built, but not installed
    install(TARGETS ${name} RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
  endif()
endfunction()

function(fr_test name)
  if(NOT FR_BUILD_TESTS)
    return()
  endif()
  cmake_parse_arguments(A "" "" "SOURCES;DEPS" ${ARGN})
  add_executable(${name} ${A_SOURCES})
  set_target_properties(${name} PROPERTIES CXX_EXTENSIONS OFF
                        RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/tests)
  target_link_libraries(${name} PRIVATE fr_options fr_warnings ${A_DEPS} GTest::gtest GTest::gtest_main)
  target_compile_definitions(${name} PRIVATE FR_SOURCE_DIR="${PROJECT_SOURCE_DIR}"
                             FR_BINARY_DIR="${PROJECT_BINARY_DIR}")
  set(properties TIMEOUT 300)
  if(FR_SANITIZE MATCHES "address")
    set(properties TIMEOUT 1200
        ENVIRONMENT LSAN_OPTIONS=suppressions=${PROJECT_SOURCE_DIR}/cmake/lsan.supp:print_suppressions=0)
  endif()
  gtest_discover_tests(${name} DISCOVERY_TIMEOUT 120 PROPERTIES ${properties})
endfunction()

# Compiles one kernel file once per instruction set, with FR_ISA naming the namespace
# (sse4, avx2, avx512); the caller chooses at run time (base/isa.h).
function(fr_isa_sources target file)
  foreach(isa IN ITEMS sse4 avx2 avx512)
    if(isa STREQUAL sse4)
      set(flags -march=x86-64-v2)
    elseif(isa STREQUAL avx2)
      set(flags -march=x86-64-v3)
    else()
      set(flags -march=x86-64-v4 -mprefer-vector-width=512)
    endif()
    get_filename_component(stem ${file} NAME_WE)
    set(obj ${target}_${stem}_${isa})
    add_library(${obj} OBJECT ${file})
    set_target_properties(${obj} PROPERTIES POSITION_INDEPENDENT_CODE ON CXX_EXTENSIONS OFF)
    target_compile_definitions(${obj} PRIVATE FR_ISA=${isa} FR_ISA_${isa}=1)
    target_compile_options(${obj} PRIVATE ${flags} $<$<NOT:$<CONFIG:Debug>>:-O3>)
    target_include_directories(${obj} PRIVATE $<TARGET_PROPERTY:${target},INTERFACE_INCLUDE_DIRECTORIES>)
    target_link_libraries(${obj} PRIVATE fr_options fr_warnings)
    target_sources(${target} PRIVATE $<TARGET_OBJECTS:${obj}>)
  endforeach()
endfunction()
