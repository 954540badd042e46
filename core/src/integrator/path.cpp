#include "integrator/context.h"
#include "integrator/guided.h"
#include "integrator/roulette.h"
#include "light/emitter_bounds.h"

namespace raykiln {

/// Unidirectional path tracing: next-event estimation and BSDF sampling at every vertex,
/// joined by multiple importance sampling, with Russian roulette (Veach 1997, chapters 8
/// to 10). Surfaces that scatter widely also look where focused light comes from.
Vec3f estimate_path(const Context& c, const Ray& camera_ray, FirstHit& first) {
    Vec3f radiance;
    Vec3f throughput(1.0f);
    float eta_scale = 1.0f;  // of the radiance, by the refractions so far
    Origin origin;           // of the ray; no light sample finds what the camera sees
    Ray ray = camera_ray;

    for (int depth = 1;; ++depth) {
        // Follow the ray; whatever glows at its end is the emission of this path length.
        const Hit hit = trace(c, ray, bsdf_group(depth));
        if (!hit.valid()) {
            return radiance + throughput * escaped_radiance(c, ray.direction, origin);
        }
        const Surface s = make_surface(c.scene, hit, ray);
        radiance += throughput * met_radiance(c, s, ray.direction, origin);
        const Bsdf bsdf = make_bsdf(*s.material, c.scene.textures, s.uv);
        if (depth == 1) {
            first = first_hit_of(s, bsdf);
        }
        if (depth >= c.settings.max_depth) {
            return radiance;
        }

        // Light that comes straight from a light, scattered here.
        const Vec3f dir_out = s.shading.to_local(-ray.direction);
        GuideAt<float> guide;
        bool lights_found = false;
        if (!is_specular(bsdf)) {
            if (c.guide != nullptr && is_guided(bsdf)) {
                guide = c.guide->find(s.p, true);
            }
            radiance += throughput *
                        sample_direct_light(c, s, bsdf, dir_out, depth, lights_found);
        }

        // Go on in a direction that the material chooses, or the guide.
        const Sample4<float> u = c.draw(bsdf_group(depth));
        const BsdfRandom<float> random{u[2], u[0], u[1]};
        const BsdfSample<float> next =
            guide.share > 0.0f
                ? sample_guided(*c.guide, guide, bsdf, s.shading, dir_out, random)
                : sample(bsdf, dir_out, random);
        throughput *= next.weight;
        if (max_component(throughput) <= 0.0f) {
            return radiance;
        }
        eta_scale *= next.eta;
        origin = {receiver_of(s, bsdf), next.specular ? 0.0f : next.pdf_solid_angle,
                  lights_found};
        ray = spawn_ray(s, normalize(s.shading.to_world(next.dir_in)));
        if (depth + 1 == c.settings.max_depth &&
            (lights_found || !may_meet_light(c.scene, ray.origin, ray.direction))) {
            return radiance;
        }

        // Russian roulette: end paths that carry little, make up for it in the others.
        if (c.settings.rr_depth >= 0 && depth >= c.settings.rr_depth) {
            const float survival = survival_probability(throughput, eta_scale);
            if (u[3] >= survival) {
                return radiance;
            }
            throughput *= 1.0f / survival;
        }
        ++c.counts.bounce;
    }
}

}  // namespace raykiln
