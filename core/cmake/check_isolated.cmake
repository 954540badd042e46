# cmake -DNM=.. -DREADELF=.. -DOBJECT=.. -DENTRY=.. -P check_isolated.cmake
#
# Fails if the object defines any symbol that other objects can see but the entry point, or
# has initialisers, which would run on every processor. A failure removes the object, so that
# the next build does not take it for good.

function(refuse reason)
  file(REMOVE ${OBJECT})
  message(FATAL_ERROR "${OBJECT}: ${reason}")
endfunction()

execute_process(
  COMMAND ${NM} --defined-only --extern-only --format=posix ${OBJECT}
  OUTPUT_VARIABLE symbols OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
string(REGEX MATCHALL "[^\n]+" lines "${symbols}")
set(found FALSE)
foreach(line IN LISTS lines)
  if(line MATCHES "^${ENTRY} T ")
    set(found TRUE)
  else()
    refuse("a symbol besides ${ENTRY} can be seen from outside: ${line}")
  endif()
endforeach()
if(NOT found)
  refuse("${ENTRY} is not defined")
endif()

execute_process(
  COMMAND ${READELF} --sections --wide ${OBJECT}
  OUTPUT_VARIABLE sections COMMAND_ERROR_IS_FATAL ANY)
string(REGEX MATCH "\\.(init_array|ctors|preinit_array|init)[^ ]* " initialisers "${sections}")
if(initialisers)
  refuse("it has initialisers (${initialisers}), which would run before the processor is asked")
endif()
