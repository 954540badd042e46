#pragma once

#include "isa/isa.h"
#include "wide/kernels.h"

namespace raykiln {

/// The wide part for an instruction set, which must run here.
const WideKernels& wide_kernels(Isa isa);

}  // namespace raykiln
