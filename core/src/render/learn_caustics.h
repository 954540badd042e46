#pragma once

#include "guide/caustic_guide.h"
#include "integrator/context.h"

namespace raykiln {

/// Learns where the surfaces of a scene focus its lights, for paths from the camera;
/// empty if nothing does. `samples`: of the whole image, whatever part of it is rendered,
/// so that every part and every resumed render has the same guide. Runs on the threads of
/// the arena that it is called in.
CausticGuide learn_caustics(const Scene& scene, const Accel& accel,
                            const EstimatorSettings& estimator, std::uint32_t seed,
                            std::uint64_t samples);

}  // namespace raykiln
