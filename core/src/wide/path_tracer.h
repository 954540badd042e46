#pragma once

#include "math/wide.h"
#include "wide/kernels.h"

namespace raykiln {
inline namespace RAYKILN_WIDE_NAMESPACE {

BatchTracer* make_path_tracer(const BatchScene& scene);

}  // namespace RAYKILN_WIDE_NAMESPACE
}  // namespace raykiln
