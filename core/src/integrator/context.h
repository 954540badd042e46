#pragma once

#include "guide/caustic_guide.h"
#include "integrator/surface.h"
#include "light/light.h"
#include "sampling/sampler.h"

namespace raykiln {

enum class IntegratorKind : std::uint8_t { path, whitted, direct, ao };

/// Which ways of finding a light an estimate joins; all have the same mean. `mis` is for
/// use, the other two are for proof.
enum class Strategy : std::uint8_t { mis, light_only, bsdf_only };

/// Rays by kind, and samples that were not finite.
struct RayCounts {
    std::uint64_t camera = 0, bounce = 0, shadow = 0, nonfinite = 0;

    RayCounts& operator+=(const RayCounts& b) {
        camera += b.camera;
        bounce += b.bounce;
        shadow += b.shadow;
        nonfinite += b.nonfinite;
        return *this;
    }
};

/// What an estimator reads. `max_depth` counts path segments; no limit = a very large
/// number.
struct EstimatorSettings {
    IntegratorKind integrator = IntegratorKind::path;
    SamplerKind sampler = SamplerKind::sobol;
    Strategy strategy = Strategy::mis;
    int max_depth = 8;
    int rr_depth = 5;
    float ao_distance = infinity;  ///< metres
};

/// The scene to trace, and the random numbers of one sample.
struct Context {
    const Scene& scene;
    const Accel& accel;
    const EstimatorSettings& settings;
    SampleKey<float> key;
    RayCounts& counts;
    const CausticGuide* guide = nullptr;  ///< of path tracing; null: none

    Sample4<float> draw(std::uint32_t group) const {
        return sample_4d(settings.sampler, key, group);
    }
};

// Dimension groups of one sample: the camera's, then two a path vertex.
constexpr std::uint32_t camera_group = 0;
constexpr std::uint32_t light_group(int vertex) {
    return 1u + 2u * static_cast<std::uint32_t>(vertex);
}
constexpr std::uint32_t bsdf_group(int vertex) {
    return 2u + 2u * static_cast<std::uint32_t>(vertex);
}

/// What the first surface that a camera ray meets is like.
struct FirstHit {
    Vec3f albedo, normal;
    Vec3f point;
    float depth = 0.0f;  ///< along the view axis, set by the renderer
    bool valid = false;
};

/// Nearest surface along a ray that is there: surfaces of fractional opacity are passed
/// at random.
Hit trace(const Context& c, Ray ray, std::uint32_t salt);

/// Whether a light sample can be seen from a surface point.
bool visible(const Context& c, const Surface& s, const LightSample& light,
             std::uint32_t salt);

/// Radiance along a camera ray.
Vec3f estimate_path(const Context& c, const Ray& ray, FirstHit& first);
Vec3f estimate_whitted(const Context& c, const Ray& ray, FirstHit& first);
Vec3f estimate_ao(const Context& c, const Ray& ray, FirstHit& first);

/// The vertex that a ray was sent from, as far as light sampling there could have found
/// what the ray meets.
struct Origin {
    LightReceiver receiver;
    float pdf_bsdf =
        0.0f;  ///< density of the ray's direction; 0: only the BSDF could find it
    bool lights_found = false;  ///< those of surfaces: by light samples alone
};

/// The receiver that lights are chosen for at a surface.
LightReceiver receiver_of(const Surface& s, const Bsdf& bsdf);

/// Radiance from beyond the scene, with the weight that the sampling of each light leaves
/// it.
Vec3f escaped_radiance(const Context& c, const Vec3f& direction, const Origin& origin);

/// Emitted radiance at a surface met, weighted as above.
Vec3f met_radiance(const Context& c, const Surface& s, const Vec3f& direction,
                   const Origin& origin);

/// Light from one sampled light, reflected into dir_out, weighted against the BSDF's own
/// sampling; `lights_found` is set where that has nothing to add.
Vec3f sample_direct_light(const Context& c, const Surface& s, const Bsdf& bsdf,
                          const Vec3f& dir_out_local, int vertex, bool& lights_found);

FirstHit first_hit_of(const Surface& s, const Bsdf& bsdf);

}  // namespace raykiln
