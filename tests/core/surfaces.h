#pragma once

#include "integrator/surface.h"
#include "light/light.h"
#include "shapes.h"

namespace raykiln::test {

struct Traced {
    Hit hit;
    Surface surface;
};

inline Traced trace_one(const Scene& scene, const Accel& accel, const Ray& ray) {
    Traced t{accel.intersect(ray), {}};
    if (t.hit.valid()) {
        t.surface = make_surface(scene, t.hit, ray);
    }
    return t;
}

/// A scene that is finished by `prepare_lights`, which surfaces look into.
inline void finish(Scene& scene) {
    if (scene.materials.empty()) {
        add_white(scene);
    }
    prepare_lights(scene);
}

}  // namespace raykiln::test
