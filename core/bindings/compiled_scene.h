#pragma once

#include <memory>

#include "accel/accel.h"
#include "light/light.h"
#include "scene/scene.h"

namespace raykiln {

/// A scene with its camera and, once built, its lights' tables and its hierarchy.
struct CompiledScene {
    Scene scene;
    Camera camera;
    std::unique_ptr<Accel> accel;

    /// Call once, after the last part is added and before rendering.
    void build() {
        accel = std::make_unique<Accel>(scene);
        scene.bounds = accel->bounds();
        prepare_lights(scene);
    }
};

}  // namespace raykiln
