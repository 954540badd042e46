#include <array>

#include "integrator/context.h"

namespace raykiln {

namespace {

/// One ray of the tree, waiting to be followed.
struct Branch {
    Ray ray;
    Vec3f weight;
    int depth;
};

// The tree is walked depth first; each refraction leaves one branch behind for each
// level.
constexpr int max_tree_depth = 64;
// Without a limit on depth the tree still ends where a branch can no longer be seen.
constexpr float least_weight = 1.0f / 1024.0f;
// More lights than this are sampled by their power; fewer are all looked at.
constexpr std::uint32_t all_lights = 16;

/// Shadow rays to the lights, one sample each.
Vec3f direct_light(const Context& c, const Surface& s, const Bsdf& bsdf,
                   const Vec3f& dir_out, std::uint32_t node) {
    const auto count = static_cast<std::uint32_t>(c.scene.lights.size());
    const bool every = count <= all_lights;
    const std::uint32_t shadow_rays = every ? count : all_lights;
    const LightReceiver receiver = receiver_of(s, bsdf);
    Vec3f sum;
    for (std::uint32_t i = 0; i < shadow_rays; ++i) {
        const std::uint32_t group = 1u + node * all_lights + i;
        const Sample4<float> u = c.draw(group);
        const float stratum =
            (static_cast<float>(i) + u[0]) / static_cast<float>(shadow_rays);
        LightTree::Choice choice{i, 1.0f};
        if (!every) {
            choice = choose_light(c.scene, receiver, min(stratum, one_minus_epsilon));
            choice.pmf *= static_cast<float>(shadow_rays);
        }
        if (choice.pmf <= 0.0f) {
            continue;
        }
        const LightSample light = sample_light(c.scene, c.scene.lights[choice.light],
                                               receiver, u[1], u[2], u[3]);
        if (!(light.pdf_solid_angle > 0.0f) || max_component(light.radiance) <= 0.0f) {
            continue;
        }
        const BsdfValue<float> f =
            evaluate(bsdf, dir_out, s.shading.to_local(light.direction));
        if (max_component(f.value) > 0.0f && visible(c, s, light, group)) {
            sum += f.value * light.radiance / (light.pdf_solid_angle * choice.pmf);
        }
    }
    return sum;
}

/// The mirror and refraction branches of a surface, with their Fresnel weights.
struct Split {
    std::array<BsdfSample<float>, 2> branches;
    int count = 0;

    void add(const BsdfSample<float>& b, float share) {
        if (share > 0.0f) {
            branches[static_cast<std::size_t>(count)] = b;
            branches[static_cast<std::size_t>(count++)].weight *= share;
        }
    }
};

Split split(const Bsdf& bsdf, const Vec3f& dir_out) {
    Split s;
    // A lobe number of 0 takes the reflection, of almost 1 the refraction.
    if (const auto* d = std::get_if<Dielectric<float>>(&bsdf)) {
        Dielectric<float> clear = *d;
        clear.smooth = true;
        float r = fresnel_dielectric(dir_out.z, d->eta).reflectance;
        if (d->thin) {
            r = thin_reflectance(
                fresnel_dielectric(std::fabs(dir_out.z), d->eta).reflectance);
        }
        s.add(sample(clear, dir_out, {-1.0f, 0, 0}), r);
        s.add(sample(clear, dir_out, {2.0f, 0, 0}), 1.0f - r);
    } else if (const auto* m = std::get_if<Conductor<float>>(&bsdf);
               m != nullptr && m->smooth) {
        s.add(sample(*m, dir_out, {0, 0, 0}), 1.0f);
    } else if (const auto* p = std::get_if<Plastic<float>>(&bsdf);
               p != nullptr && p->smooth && dir_out.z > 0.0f) {
        const float r = fresnel_dielectric(dir_out.z, p->eta).reflectance;
        s.add({reflect(dir_out), p->specular, 1.0f, 1.0f, true}, r);
    }
    return s;
}

}  // namespace

/// Whitted 1980, "An Improved Illumination Model for Shaded Display": at each surface,
/// shadow rays to the lights, and the perfect reflection and refraction, weighted by
/// Fresnel's equations. No light between diffuse surfaces; rough surfaces show the lights
/// only.
Vec3f estimate_whitted(const Context& c, const Ray& camera_ray, FirstHit& first) {
    std::array<Branch, max_tree_depth + 2> stack;
    int size = 0;
    stack[static_cast<std::size_t>(size++)] = {camera_ray, Vec3f(1.0f), 1};
    const int max_depth = std::min(c.settings.max_depth, max_tree_depth);
    Vec3f radiance;
    for (std::uint32_t node = 0; size > 0; ++node) {
        const Branch branch = stack[static_cast<std::size_t>(--size)];
        const Hit hit = trace(c, branch.ray, 0x80000000u + node);
        if (!hit.valid()) {
            radiance +=
                branch.weight * escaped_radiance(c, branch.ray.direction, Origin{});
            continue;
        }
        const Surface s = make_surface(c.scene, hit, branch.ray);
        const Vec3f seen = met_radiance(c, s, branch.ray.direction, Origin{});
        radiance += branch.weight * seen;
        const Bsdf bsdf = make_bsdf(*s.material, c.scene.textures, s.uv);
        if (node == 0) {
            first = first_hit_of(s, bsdf);
        }
        if (branch.depth >= max_depth) {
            continue;
        }
        const Vec3f dir_out = s.shading.to_local(-branch.ray.direction);
        // A rough interface is taken for a clear one, so that it splits light only once.
        if (!is_specular(bsdf) && !std::holds_alternative<Dielectric<float>>(bsdf)) {
            radiance += branch.weight * direct_light(c, s, bsdf, dir_out, node);
        }
        const Split next = split(bsdf, dir_out);
        for (int i = 0; i < next.count; ++i) {
            const BsdfSample<float>& b = next.branches[static_cast<std::size_t>(i)];
            const Vec3f weight = branch.weight * b.weight;
            if (max_component(weight) >= least_weight) {
                const Vec3f direction = normalize(s.shading.to_world(b.dir_in));
                stack[static_cast<std::size_t>(size++)] = {spawn_ray(s, direction),
                                                           weight, branch.depth + 1};
                ++c.counts.bounce;
            }
        }
    }
    return radiance;
}

}  // namespace raykiln
