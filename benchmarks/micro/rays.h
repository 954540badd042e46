#pragma once

#include <vector>

#include "accel/accel.h"
#include "scenes.h"

// Rays as a path tracer sends them, recorded to be traced again and again.

namespace raykiln::bench {

struct RaySet {
    std::vector<Ray> primary;  ///< through the pixels, 4 x 4 neighbours in a row
    std::vector<Ray> bounce;   ///< from what those met, by the cosine
    std::vector<Ray> shadow;   ///< from there to a chosen light, or to the sky
};

/// One path vertex for each pixel of a size x size image.
RaySet record_rays(const View& view, const Accel& accel, int size);

}  // namespace raykiln::bench
