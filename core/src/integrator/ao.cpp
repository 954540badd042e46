#include "integrator/context.h"

namespace raykiln {

/// Ambient occlusion: the cosine-weighted share of the hemisphere that is open.
Vec3f estimate_ao(const Context& c, const Ray& ray, FirstHit& first) {
    const Hit hit = trace(c, ray, bsdf_group(0));
    if (!hit.valid()) {
        return Vec3f(1.0f);
    }
    const Surface s = make_surface(c.scene, hit, ray);
    first = first_hit_of(s, make_bsdf(*s.material, c.scene.textures, s.uv));
    const Frame<float> frame =
        frame_of_normal(dot(s.normal, ray.direction) > 0.0f ? -s.normal : s.normal);
    const Sample4<float> u = c.draw(bsdf_group(1));
    Ray probe =
        spawn_ray(s, normalize(frame.to_world(sample_cosine_hemisphere(u[0], u[1]))));
    probe.t_far = c.settings.ao_distance;
    ++c.counts.shadow;
    const bool open = c.scene.has_opacity ? !trace(c, probe, bsdf_group(1)).valid()
                                          : !c.accel.occluded(probe);
    return Vec3f(open ? 1.0f : 0.0f);
}

}  // namespace raykiln
