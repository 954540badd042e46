#pragma once

#include "scene/scene.h"

namespace raykiln {

/// Chooses a light for a receiver by what it may contribute there: beyond the scene by
/// power, in it by the light tree. A probability of 0: no light reaches the receiver.
template <class F>
inline LightChoiceOf<F> choose_light(const Scene& scene,
                                     const LightReceiverOf<F>& receiver, F u) {
    const float share = scene.far_share;
    LightChoiceOf<F> choice{Uint<F>(0u), F(0.0f)};
    const auto far = u < F(share);
    if (any(!far)) {
        const F rest = max((u - F(share)) / F(1.0f - share), F(0.0f));
        choice = scene.near_lights.sample(receiver, rest);
        choice.pmf = choice.pmf * F(1.0f - share);
    }
    if (share > 0.0f) {
        // Not known where the tree was not asked.
        choice.small = Mask<F>(false);
    }
    if (any(far)) {
        F unused;
        const F among = min(u, F(share * one_minus_epsilon)) / F(share);
        const Uint<F> i = scene.far_choice.sample(among, unused);
        choice.light = select(far, gather(scene.far_lights.data(), i), choice.light);
        choice.pmf = select(far, F(share) * scene.far_choice.pmf_at<F>(i), choice.pmf);
    }
    return choice;
}

/// The probability with which `choose_light` returns a light of the scene's surfaces.
template <class F>
inline F pmf_of_near_light(const Scene& scene, const LightReceiverOf<F>& receiver,
                           Uint<F> light) {
    return F(1.0f - scene.far_share) * scene.near_lights.pmf(receiver, light);
}
/// The same for number `i` of `Scene::far_lights`.
inline float pmf_of_far_light(const Scene& scene, std::uint32_t i) {
    return scene.far_share * scene.far_choice.pmf(i);
}
/// The probability with which `choose_light` returns a light.
float pmf_of_light(const Scene& scene, const LightReceiver& receiver,
                   std::uint32_t light);

/// A point on a light as seen from a surface point.
template <class F>
struct LightSampleOf {
    Vec3<F> direction;  ///< unit, away from the surface point
    Vec3<F> point;      ///< where the light is, moved off its surface; unused if infinite
    Mask<F> infinite = Mask<F>(false);  ///< beyond all geometry
    Vec3<F>
        radiance;  ///< arriving; for a delta light already divided by its (delta) density
    F pdf_solid_angle;  ///< of `direction`, given the light; 1 for a delta light
    Mask<F> delta = Mask<F>(false);  ///< no other strategy can find it
};
using LightSample = LightSampleOf<float>;

/// Samples one light towards a receiver. Radiance 0 (and density 0) where the light does
/// not reach it.
LightSample sample_light(const Scene& scene, const Light& light,
                         const LightReceiver& receiver, float u, float v, float w);

/// Density over solid angle with which `sample_light` finds the point hit by a ray from
/// `p` in unit `direction`, `distance` away, on a light of the scene's surfaces.
float pdf_light(const Light& light, const Vec3f& p, const Vec3f& direction,
                float distance);

/// Makes lights of emissive triangles (one of two that make a parallelogram) and spheres,
/// and the tables to choose lights by power.
void prepare_lights(Scene& scene);

}  // namespace raykiln
