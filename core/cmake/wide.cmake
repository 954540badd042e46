# The wide part of the core, compiled once for each instruction set and chosen at run time
# (docs/decisions/0014-simd.md).
#
# The linker keeps one copy of an inline function that many objects define, whichever comes
# first. It must never be a copy made of AVX-512 instructions for code that also runs on older
# processors. So the objects of each instruction set are linked into one, in which all symbols
# but the entry point are local; the build fails if one escapes, or if code would run before
# the choice is made.

file(GLOB RAYKILN_WIDE_SOURCES CONFIGURE_DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/src/wide/*.cpp)
list(FILTER RAYKILN_WIDE_SOURCES EXCLUDE REGEX "/dispatch\\.cpp$")

set(RAYKILN_ISAS sse42 avx2 avx512)
set(RAYKILN_ISA_FLAGS_sse42 -march=x86-64-v2)
set(RAYKILN_ISA_FLAGS_avx2 -march=x86-64-v3)
set(RAYKILN_ISA_FLAGS_avx512 -march=x86-64-v4 -mprefer-vector-width=512)
# Fused multiply-add where the instruction set has it: faster, and rounded once less. The
# bits are promised for each instruction set, not across them.
foreach(isa IN LISTS RAYKILN_ISAS)
  list(APPEND RAYKILN_ISA_FLAGS_${isa} -ffp-contract=fast)
endforeach()

# Sanitizers keep tables of symbols and initialisers of their own, which bears no hiding:
# they get the baseline alone.
if(RAYKILN_SANITIZE)
  set(RAYKILN_ISAS sse42)
  target_compile_definitions(raykiln_options INTERFACE RAYKILN_BASELINE_ONLY)
endif()

function(raykiln_add_wide isa)
  set(library raykiln_wide_${isa})
  add_library(${library} OBJECT ${RAYKILN_WIDE_SOURCES})
  target_link_libraries(${library} PRIVATE raykiln_options TBB::tbb)
  target_include_directories(${library} PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/src)
  target_compile_options(${library} PRIVATE ${RAYKILN_ISA_FLAGS_${isa}} -fno-gnu-unique)
  target_compile_definitions(${library} PRIVATE RAYKILN_WIDE_ENTRY=raykiln_wide_${isa})
  set_target_properties(${library} PROPERTIES CXX_VISIBILITY_PRESET hidden
                                              INTERPROCEDURAL_OPTIMIZATION OFF)
  if(RAYKILN_SANITIZE)
    target_sources(raykiln_core PRIVATE $<TARGET_OBJECTS:${library}>)
    return()
  endif()
  set(object ${CMAKE_CURRENT_BINARY_DIR}/${library}.o)
  add_custom_command(
    OUTPUT ${object}
    COMMAND ${CMAKE_LINKER} -r --force-group-allocation -o ${object}.whole
            $<TARGET_OBJECTS:${library}>
    COMMAND ${CMAKE_OBJCOPY} --keep-global-symbol=${library} ${object}.whole ${object}
    COMMAND ${CMAKE_COMMAND} -DNM=${CMAKE_NM} -DREADELF=${CMAKE_READELF} -DOBJECT=${object}
            -DENTRY=${library} -P ${CMAKE_CURRENT_SOURCE_DIR}/cmake/check_isolated.cmake
    DEPENDS ${library} $<TARGET_OBJECTS:${library}>
            ${CMAKE_CURRENT_SOURCE_DIR}/cmake/check_isolated.cmake
    COMMAND_EXPAND_LISTS VERBATIM
    COMMENT "Hiding all of ${library} but its entry point")
  set_source_files_properties(${object} PROPERTIES EXTERNAL_OBJECT ON GENERATED ON)
  target_sources(raykiln_core PRIVATE ${object})
endfunction()

foreach(isa IN LISTS RAYKILN_ISAS)
  raykiln_add_wide(${isa})
endforeach()
