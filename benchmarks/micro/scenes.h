#pragma once

#include "scene/camera.h"
#include "scene/scene.h"

// Scenes of the micro benchmarks, made by code.

namespace raykiln::bench {

struct View {
    Scene scene;
    Camera camera;
};

/// A closed room of 34 triangles with two boxes and a light.
View cornell_box();

/// A ball of 20 * 4^levels triangles, 10 % of its radius rough, under a constant sky;
/// 1.3 million triangles with 8 levels.
View displaced_ball(int levels);

/// The room with `count` small triangle lights in place of its own.
View many_lights(std::uint32_t count);

}  // namespace raykiln::bench
