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

# Compiles the sources (after `isa`) for one instruction set and adds the result to `target`.
# All but the C function `entry` is local to it; the sources know its name as
# RAYKILN_WIDE_ENTRY.
function(raykiln_add_isolated target entry isa)
  add_library(${entry} OBJECT ${ARGN})
  target_link_libraries(${entry} PRIVATE raykiln_options TBB::tbb)
  target_include_directories(${entry} PRIVATE ${raykiln_SOURCE_DIR}/src)
  target_compile_options(${entry} PRIVATE ${RAYKILN_ISA_FLAGS_${isa}} -fno-gnu-unique)
  target_compile_definitions(${entry} PRIVATE RAYKILN_WIDE_ENTRY=${entry})
  set_target_properties(${entry} PROPERTIES CXX_VISIBILITY_PRESET hidden
                                            INTERPROCEDURAL_OPTIMIZATION OFF)
  if(RAYKILN_SANITIZE)
    target_sources(${target} PRIVATE $<TARGET_OBJECTS:${entry}>)
    return()
  endif()
  set(object ${CMAKE_CURRENT_BINARY_DIR}/${entry}.o)
  set(check ${raykiln_SOURCE_DIR}/cmake/check_isolated.cmake)
  add_custom_command(
    OUTPUT ${object}
    COMMAND ${CMAKE_LINKER} -r --force-group-allocation -o ${object}.whole
            $<TARGET_OBJECTS:${entry}>
    COMMAND ${CMAKE_OBJCOPY} --keep-global-symbol=${entry} ${object}.whole ${object}
    COMMAND ${CMAKE_COMMAND} -DNM=${CMAKE_NM} -DREADELF=${CMAKE_READELF} -DOBJECT=${object}
            -DENTRY=${entry} -P ${check}
    DEPENDS ${entry} $<TARGET_OBJECTS:${entry}> ${check}
    COMMAND_EXPAND_LISTS VERBATIM
    COMMENT "Hiding all of ${entry} but its entry point")
  set_source_files_properties(${object} PROPERTIES EXTERNAL_OBJECT ON GENERATED ON)
  target_sources(${target} PRIVATE ${object})
endfunction()

foreach(isa IN LISTS RAYKILN_ISAS)
  raykiln_add_isolated(raykiln_core raykiln_wide_${isa} ${isa} ${RAYKILN_WIDE_SOURCES})
endforeach()
