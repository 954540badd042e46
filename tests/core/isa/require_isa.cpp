#include <unistd.h>

#include <cstdio>
#include <string_view>

// Linked to tests that are built for a newer processor than this one may be: ends the
// program, as passed, before any of their code runs.

namespace {

bool can_run(std::string_view isa) {
    __builtin_cpu_init();
    return isa == "avx512" ? __builtin_cpu_supports("x86-64-v4")
                           : __builtin_cpu_supports("x86-64-v3");
}

// Constructors of the lowest priority number run first, and those of tests have none.
[[gnu::constructor(101)]] void skip_unless_runnable() {
    if (!can_run(RAYKILN_TEST_ISA)) {
        std::puts("skipped: this processor does not run " RAYKILN_TEST_ISA);
        std::fflush(stdout);
        _exit(0);
    }
}

}  // namespace
