#pragma once

#include <string>

namespace raykiln {

/// The instruction sets that the ray kernels and the wide part of the shading are built
/// for; each includes those before it. SSE4.2 (x86-64-v2) is what the rest is built for.
enum class Isa { sse42, avx2, avx512 };

/// "sse4.2", "avx2" or "avx512".
const char* isa_name(Isa isa);

/// Whether this processor and its operating system run it.
bool can_run(Isa isa);

/// The one that `name` names, or the best that runs here if it is null or empty. Throws
/// SettingsError for any other name, and for one that does not run here.
Isa select_isa(const char* name);

/// What this process uses: `select_isa` of the environment variable RAYKILN_ISA, read
/// once.
Isa process_isa();

}  // namespace raykiln
