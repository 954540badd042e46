#include "isa/isa.h"

#include <cstdlib>

#include "error.h"

namespace raykiln {

namespace {

#ifdef RAYKILN_BASELINE_ONLY
constexpr Isa built[] = {Isa::sse42};
#else
constexpr Isa built[] = {Isa::avx512, Isa::avx2, Isa::sse42};
#endif

std::string runnable_names() {
    std::string names;
    for (const Isa isa : built) {
        if (can_run(isa)) {
            names = isa_name(isa) + (names.empty() ? "" : ", " + names);
        }
    }
    return names;
}

}  // namespace

const char* isa_name(Isa isa) {
    return isa == Isa::avx512 ? "avx512" : isa == Isa::avx2 ? "avx2" : "sse4.2";
}

bool can_run(Isa isa) {
    switch (isa) {
        case Isa::avx512:
            return __builtin_cpu_supports("x86-64-v4") != 0;
        case Isa::avx2:
            return __builtin_cpu_supports("x86-64-v3") != 0;
        case Isa::sse42:
            return true;
    }
    return false;
}

Isa select_isa(const char* name) {
    const std::string wanted = name == nullptr ? "" : name;
    for (const Isa isa : built) {
        if ((wanted.empty() || wanted == isa_name(isa)) && can_run(isa)) {
            return isa;
        }
    }
    throw SettingsError("RAYKILN_ISA: this instruction set cannot be used here (found " +
                        wanted.substr(0, 40) + "); accepted: " + runnable_names());
}

Isa process_isa() {
    static const Isa isa = select_isa(std::getenv("RAYKILN_ISA"));
    return isa;
}

}  // namespace raykiln
