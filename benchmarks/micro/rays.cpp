#include "rays.h"

#include "camera/camera.h"
#include "light/light.h"
#include "sampling/sampler.h"
#include "sampling/warp.h"

namespace raykiln::bench {

namespace {

constexpr int block = 4;

void add_vertex(RaySet& rays, const View& view, const Ray& ray, const Hit& hit,
                const SampleKey<float>& key) {
    const auto u = sobol_sample(key, 1), w = sobol_sample(key, 2);
    const Vec3f unit = normalize(hit.normal);
    const Vec3f normal = dot(unit, ray.direction) > 0 ? -unit : unit;
    const Vec3f p = offset_origin(ray.origin + ray.direction * hit.t, normal, normal,
                                  position_error(10.0f));
    rays.bounce.push_back(
        {p, frame_of_normal(normal).to_world(sample_cosine_hemisphere(u[0], u[1]))});
    const auto choice = choose_light(view.scene, LightReceiver{p, normal}, w[0]);
    const LightSample light = sample_light(view.scene, view.scene.lights[choice.light],
                                           {p, normal}, w[1], w[2], w[3]);
    if (dot(light.direction, normal) > 0) {
        rays.shadow.push_back(
            {p, light.direction, 0.0f,
             light.infinite ? infinity : length(light.point - p) * 0.999f});
    }
}

}  // namespace

RaySet record_rays(const View& view, const Accel& accel, int size) {
    RaySet rays;
    const int blocks = size / block;
    for (int i = 0; i < size * size; ++i) {
        const int in_block = i % (block * block), at = i / (block * block);
        const int x = at % blocks * block + in_block % block;
        const int y = at / blocks * block + in_block / block;
        const auto key = sample_key(0, static_cast<std::uint32_t>(x),
                                    static_cast<std::uint32_t>(y), 0);
        const auto u = sobol_sample(key, 0);
        const Ray ray = camera_ray(view.camera, (static_cast<float>(x) + u[0]) / size,
                                   (static_cast<float>(y) + u[1]) / size);
        rays.primary.push_back(ray);
        const Hit hit = accel.intersect(ray);
        if (hit.valid()) {
            add_vertex(rays, view, ray, hit, key);
        }
    }
    return rays;
}

}  // namespace raykiln::bench
