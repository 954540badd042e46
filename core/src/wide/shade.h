#pragma once

#include "bsdf/make_bsdf.h"
#include "integrator/geometry.h"
#include "integrator/guided.h"
#include "integrator/mis.h"
#include "integrator/roulette.h"
#include "integrator/surface.h"
#include "light/emitter_bounds.h"
#include "light/sample_light.h"
#include "wide/met_shapes.h"
#include "wide/planes.h"

// One vertex of as many paths as there are lanes, all on the same material.

namespace raykiln {
inline namespace RAYKILN_WIDE_NAMESPACE {

inline Geometry<F> geometry_of(const MetShapes& met, const Paths& paths, U slots) {
    Geometry<F> g;
    if (!all(met.on_sphere)) {
        g = triangle_geometry(met.corners, paths.hit_u[slots], paths.hit_v[slots]);
    }
    if (any(met.on_sphere)) {
        const auto round = sphere_geometry(met.sphere.center, met.sphere.radius,
                                           paths.hit_normal[slots]);
        g = select<F>(met.on_sphere, round, g);
    }
    if (any(met.placed)) {
        g = select<F>(met.placed, in_world(g, met.world_from_group), g);
    }
    return g;
}

/// Radiance that the surfaces emit towards where the rays came from, weighted by what the
/// sampling of each light leaves it.
inline Vec3<F> met_radiance(const BatchScene& b, const Paths& paths, U slots, M emits,
                            const MetShapes& met, const SurfacePoint<F>& s,
                            const Vec3<F>& direction) {
    const F pdf_bsdf = paths.pdf_bsdf[slots];
    const Vec3<F> zero(F(0.0f));
    emits = emits & (pdf_bsdf >= F(0.0f));
    if (!any(emits)) {
        return zero;
    }
    const M front = dot(s.normal, direction) < F(0.0f);
    Vec3<F> radiance = emitted_radiance<F>(
        b.scene,
        select(emits, met.emission, U(met.emission.lane(std::countr_zero(bits(emits))))),
        s.uv, front);
    radiance = select(emits, radiance, zero);
    const M rivals = emits & (pdf_bsdf > F(0.0f)) & (max_component(radiance) > F(0.0f));
    if (!any(rivals)) {
        return radiance;
    }
    const LightReceiverOf<F> from{paths.from[slots], paths.from_normal[slots]};
    const U light = select(rivals, met.light, U(0u));
    const F pdf =
        pdf_light(b.scene, light, rivals, from.p, direction, length(s.p - from.p)) *
        pmf_of_near_light(b.scene, from, light);
    const F weight = weight_of_bsdf(b.estimator.strategy, pdf_bsdf, pdf);
    return radiance * select(rivals, weight, F(1.0f));
}

/// Radiance from beyond the scene, weighted as above.
inline Vec3<F> escaped_radiance(const BatchScene& b, const Paths& paths, U slots) {
    Vec3<F> sum(F(0.0f));
    const Vec3<F> direction = paths.direction[slots];
    const F pdf_bsdf = paths.pdf_bsdf[slots];
    const M rivals = pdf_bsdf > F(0.0f);
    for (std::uint32_t i = 0; i < b.scene.far_lights.size(); ++i) {
        const auto* light =
            std::get_if<EnvironmentLight>(&b.scene.lights[b.scene.far_lights[i]]);
        if (light == nullptr) {
            continue;
        }
        const SkyPoint<F> at = sky_point(*light, direction);
        F weight(1.0f);
        if (any(rivals)) {
            const F pdf = pdf_environment(*light, paths.from_normal[slots], at) *
                          F(pmf_of_far_light(b.scene, i));
            weight = select(rivals, weight_of_bsdf(b.estimator.strategy, pdf_bsdf, pdf),
                            weight);
        }
        sum += environment_radiance(*light, b.scene.textures, at) * weight;
    }
    return sum;
}

/// What the lanes of one call of `shade` have in common.
struct Vertex {
    const BatchScene& b;
    Paths& paths;
    ShadowRays& shadows;
    Batch& batch;
    MetShapes& met;
    int depth;
    U slots;
    M valid;
    RayCounts& counts;

    template <std::uint32_t wanted>
    Sample4<F> draw(std::uint32_t group) const {
        const SampleKey<F> key{paths.pixel_key[slots], paths.sample_index[slots]};
        return sample_4d<F, wanted>(b.estimator.sampler, key, group);
    }
};

/// Where a material may send light on at all.
template <class B>
inline M may_scatter(const B&) {
    return M(true);
}
inline M may_scatter(const Diffuse<F>& bsdf) {
    return max_component(bsdf.reflectance) > F(0.0f);
}

/// Chooses a light by what it may contribute, and leaves a shadow ray to it with the
/// light that the surface scatters from there. Returns where BSDF samples have nothing to
/// add to the lights of surfaces.
template <class B>
inline M sample_direct_light(const Vertex& at, const SurfacePoint<F>& s, const B& bsdf,
                             const Vec3<F>& dir_out, const Vec3<F>& throughput,
                             const LightReceiverOf<F>& receiver) {
    // Only the sky takes a fourth number.
    const Sample4<F> u = at.b.scene.light_table.environments.empty()
                             ? at.draw<first_three>(light_group(at.depth))
                             : at.draw<all_four>(light_group(at.depth));
    const LightChoiceOf<F> choice = choose_light(at.b.scene, receiver, u[0]);
    const M lights_found =
        choice.small & M(leaves_small_lights(at.b.estimator.strategy, bsdf));
    M wanted = at.valid & (choice.pmf > F(0.0f));
    if (!any(wanted)) {
        return lights_found;
    }
    const LightSampleOf<F> light =
        sample_light(at.b.scene, choice.light, wanted, receiver, u[1], u[2], u[3]);
    wanted = wanted & (light.pdf_solid_angle > F(0.0f));
    const BsdfValue<F> f = evaluate(bsdf, dir_out, s.shading.to_local(light.direction));
    const F pdf = light.pdf_solid_angle * choice.pmf;
    const F weight = weight_of_light(at.b.estimator.strategy, light.delta | lights_found,
                                     pdf, f.pdf_solid_angle);
    const Vec3<F> seen = f.value * light.radiance;
    wanted = wanted & (max_component(seen) > F(0.0f));
    const Vec3<F> origin = offset_origin(s.p, s.normal, light.direction, s.error);
    // To a point: the ray is that segment, so that its end cannot pass the light by
    // rounding.
    const Vec3<F> direction =
        select(light.infinite, light.direction, light.point - origin);
    ShadowRays& rays = at.shadows;
    const int end = rays.size;
    rays.origin.append(wanted, end, origin);
    rays.direction.append(wanted, end, direction);
    rays.light.append(wanted, end, throughput * seen * (weight / pdf));
    compress_store(wanted, select(light.infinite, F(infinity), F(1.0f - 1e-6f)),
                   rays.t_far.at + end);
    if (at.b.sorts_shadows()) {
        const U chosen = select(wanted, choice.light, U(0u));
        compress_store(wanted, at.b.scene.near_lights.place<F>(chosen),
                       rays.place.at + end);
    }
    rays.size += compress_store(wanted, at.slots, rays.slot.at + end);
    return lights_found;
}

template <class B>
inline void store_first_hit(const Vertex& at, const SurfacePoint<F>& s, const B& bsdf) {
    const auto put = [&](float* to, F value) { scatter(at.valid, to, at.slots, value); };
    const Vec3<F> color = albedo(bsdf);
    put(at.batch.albedo[0], color.x);
    put(at.batch.albedo[1], color.y);
    put(at.batch.albedo[2], color.z);
    put(at.batch.normal[0], s.shading.n.x);
    put(at.batch.normal[1], s.shading.n.y);
    put(at.batch.normal[2], s.shading.n.z);
    const Camera& camera = at.b.camera;
    put(at.batch.depth, F(0.0f) - dot(s.p - in_lanes(camera.origin),
                                      in_lanes(camera.world_from_camera.n)));
    scatter(at.valid, at.batch.hit, at.slots, U(1u));
}

/// The numbers that sampling a material's direction takes.
template <class B>
inline Sample4<F> draw_for(const B&, const Vertex& at) {
    return at.draw<first_three>(bsdf_group(at.depth));
}
inline Sample4<F> draw_for(const Diffuse<F>&, const Vertex& at) {
    return at.draw<first_two>(bsdf_group(at.depth));
}
inline Sample4<F> draw_for(const Conductor<F>&, const Vertex& at) {
    return at.draw<first_two>(bsdf_group(at.depth));
}
inline Sample4<F> draw_for(const Dielectric<F>& bsdf, const Vertex& at) {
    return bsdf.smooth || bsdf.thin ? at.draw<the_third>(bsdf_group(at.depth))
                                    : at.draw<first_three>(bsdf_group(at.depth));
}

/// Goes on in a direction that the material chooses, or the guide, or ends the path.
template <class B>
inline void scatter_paths(const Vertex& at, const SurfacePoint<F>& s, const B& bsdf,
                          const Vec3<F>& dir_out, Vec3<F> throughput,
                          const LightReceiverOf<F>& receiver, M lights_found,
                          const GuideAt<F>& guide) {
    const bool guided = any(guide.share > F(0.0f));
    const Sample4<F> u =
        guided ? at.draw<first_three>(bsdf_group(at.depth)) : draw_for(bsdf, at);
    const BsdfRandom<F> random{u[2], u[0], u[1]};
    const BsdfSample<F> next =
        guided ? sample_guided(*at.b.guide, guide, bsdf, s.shading, dir_out, random)
               : sample(bsdf, dir_out, random);
    throughput *= next.weight;
    M alive = at.valid & (max_component(throughput) > F(0.0f));
    const F eta_scale = at.paths.eta_scale[at.slots] * next.eta;
    // Russian roulette: end paths that carry little, make up for it in the others.
    const EstimatorSettings& e = at.b.estimator;
    if (e.rr_depth >= 0 && at.depth >= e.rr_depth) {
        const F survival = survival_probability(throughput, eta_scale);
        alive = alive & (at.draw<the_fourth>(bsdf_group(at.depth))[3] < survival);
        throughput *= F(1.0f) / survival;
    }
    const Vec3<F> direction = normalize(s.shading.to_world(next.dir_in));
    const Vec3<F> origin = offset_origin(s.p, s.normal, direction, s.error);
    if (at.depth + 1 == e.max_depth) {
        alive = alive & !lights_found & may_meet_light(at.b.scene, origin, direction);
    }
    Paths& p = at.paths;
    p.throughput.put(alive, at.slots, throughput);
    p.eta_scale.put(alive, at.slots, eta_scale);
    if (any(alive & !lights_found)) {
        p.from.put(alive, at.slots, s.p);
        p.from_normal.put(alive, at.slots, receiver.normal);
    }
    const F pdf = select(next.specular, F(0.0f), next.pdf_solid_angle);
    p.pdf_bsdf.put(alive, at.slots, select(lights_found, F(0.0f) - pdf, pdf));
    p.origin.put(alive, at.slots, origin);
    p.direction.put(alive, at.slots, direction);
    scatter(at.valid, p.alive.at, at.slots, select(alive, U(1u), U(0u)));
    at.counts.bounce += static_cast<std::uint64_t>(count(alive));
}

/// All that happens at one vertex.
template <class Kind>
inline void shade(const Vertex& at, const Material& material, const Kind& kind) {
    const BatchScene& b = at.b;
    const Vec3<F> direction = at.paths.direction[at.slots];
    fetch_shapes(b, at.paths, at.slots, at.met);
    const MetShapes& met = at.met;
    const SurfacePoint<F> s =
        surface_point(geometry_of(met, at.paths, at.slots), met.sign, material,
                      b.scene.textures, -direction);
    const Vec3<F> throughput = at.paths.throughput[at.slots];
    const M emits = at.valid & met.emits;
    if (any(emits)) {
        at.paths.radiance.add(
            emits, at.slots,
            throughput * met_radiance(b, at.paths, at.slots, emits, met, s, direction));
    }
    const bool last = at.depth >= b.estimator.max_depth;
    const bool first = at.depth == 1 && b.first_hits;
    if (last && !first) {
        return;
    }
    const auto bsdf = make_bsdf(kind, detail::Parameters<F>{b.scene.textures, s.uv});
    if (first) {
        store_first_hit(at, s, bsdf);
    }
    if (last) {
        return;
    }
    if (!any(at.valid & may_scatter(bsdf))) {
        scatter(at.valid, at.paths.alive.at, at.slots, U(0u));
        return;
    }
    const Vec3<F> dir_out = s.shading.to_local(-direction);
    const LightReceiverOf<F> receiver{
        s.p, select(is_transmissive(bsdf), Vec3<F>(F(0.0f)), s.shading.n)};
    GuideAt<F> guide;
    M lights_found(false);
    if (!is_specular(material) && !b.scene.lights.empty()) {
        if (b.guide != nullptr && is_guided(bsdf)) {
            guide = b.guide->find(s.p, at.valid);
        }
        lights_found = sample_direct_light(at, s, bsdf, dir_out, throughput, receiver);
    }
    scatter_paths(at, s, bsdf, dir_out, throughput, receiver, lights_found, guide);
}

}  // namespace RAYKILN_WIDE_NAMESPACE
}  // namespace raykiln
