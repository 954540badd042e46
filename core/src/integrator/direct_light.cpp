#include "integrator/mis.h"
#include "light/sample_light.h"

namespace raykiln {

Hit trace(const Context& c, Ray ray, std::uint32_t salt) {
    for (std::uint32_t layer = 0;; ++layer) {
        const Hit hit = c.accel.intersect(ray);
        if (!hit.valid() || !c.scene.has_opacity) {
            return hit;
        }
        const float opacity = opacity_at(c.scene, hit);
        const auto bits = hash_combine(hash_combine(c.key.pixel, c.key.index),
                                       hash_combine(salt, layer + 0x51ed27u));
        if (unit_from_bits(bits) < opacity) {
            return hit;
        }
        ray.t_near = hit.t * 1.00001f;
    }
}

bool visible(const Context& c, const Surface& s, const LightSample& light,
             std::uint32_t salt) {
    ++c.counts.shadow;
    const Vec3f origin = offset_origin(s.p, s.normal, light.direction, s.error);
    // To a point: the ray is that segment, so that its end cannot pass the light by
    // rounding.
    const Ray ray = light.infinite
                        ? Ray{origin, light.direction}
                        : Ray{origin, light.point - origin, 0.0f, 1.0f - 1e-6f};
    if (!c.scene.has_opacity) {
        return !c.accel.occluded(ray);
    }
    return !trace(c, ray, salt).valid();
}

LightReceiver receiver_of(const Surface& s, const Bsdf& bsdf) {
    return {s.p, is_transmissive(bsdf) ? Vec3f{} : s.shading.n};
}

Vec3f escaped_radiance(const Context& c, const Vec3f& direction, const Origin& origin) {
    Vec3f sum;
    for (const std::uint32_t index : c.scene.far_lights) {
        const auto* light = std::get_if<EnvironmentLight>(&c.scene.lights[index]);
        if (light == nullptr) {
            continue;
        }
        const SkyPoint<float> at = sky_point(*light, direction);
        const Vec3f radiance = environment_radiance(*light, c.scene.textures, at);
        if (origin.pdf_bsdf <= 0.0f) {
            sum += radiance;
            continue;
        }
        const float pdf = pdf_environment(*light, origin.receiver.normal, at) *
                          pmf_of_light(c.scene, origin.receiver, index);
        sum += radiance * weight_of_bsdf(c.settings.strategy, origin.pdf_bsdf, pdf);
    }
    return sum;
}

Vec3f met_radiance(const Context& c, const Surface& s, const Vec3f& direction,
                   const Origin& origin) {
    if (s.emission == no_index || origin.lights_found) {
        return Vec3f(0.0f);
    }
    const bool front = dot(s.normal, direction) < 0.0f;
    const Vec3f radiance = emitted_radiance<float>(c.scene, s.emission, s.uv, front);
    if (origin.pdf_bsdf <= 0.0f || max_component(radiance) <= 0.0f) {
        return radiance;
    }
    const Vec3f& from = origin.receiver.p;
    const float pdf =
        pdf_light(c.scene.lights[s.light], from, direction, length(s.p - from)) *
        pmf_of_light(c.scene, origin.receiver, s.light);
    return radiance * weight_of_bsdf(c.settings.strategy, origin.pdf_bsdf, pdf);
}

Vec3f sample_direct_light(const Context& c, const Surface& s, const Bsdf& bsdf,
                          const Vec3f& dir_out_local, int vertex, bool& lights_found) {
    if (c.scene.lights.empty()) {
        return Vec3f(0.0f);
    }
    // Choose a light by what it may contribute here, and a direction towards it.
    const Sample4<float> u = c.draw(light_group(vertex));
    const LightReceiver receiver = receiver_of(s, bsdf);
    const LightTree::Choice choice = choose_light(c.scene, receiver, u[0]);
    lights_found = choice.small && leaves_small_lights(c.settings.strategy, bsdf);
    if (choice.pmf <= 0.0f) {
        return Vec3f(0.0f);
    }
    const LightSample light =
        sample_light(c.scene, c.scene.lights[choice.light], receiver, u[1], u[2], u[3]);
    if (!(light.pdf_solid_angle > 0.0f) || max_component(light.radiance) <= 0.0f) {
        return Vec3f(0.0f);
    }

    // What the surface makes of light from there.
    const BsdfValue<float> f =
        evaluate(bsdf, dir_out_local, s.shading.to_local(light.direction));
    if (max_component(f.value) <= 0.0f || !visible(c, s, light, light_group(vertex))) {
        return Vec3f(0.0f);
    }
    const float pdf = light.pdf_solid_angle * choice.pmf;
    const float weight = weight_of_light(c.settings.strategy, light.delta || lights_found,
                                         pdf, f.pdf_solid_angle);
    return f.value * light.radiance * (weight / pdf);
}

FirstHit first_hit_of(const Surface& s, const Bsdf& bsdf) {
    return {albedo(bsdf), s.shading.n, s.p, 0.0f, true};
}

}  // namespace raykiln
