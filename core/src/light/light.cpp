#include "light/light.h"

#include "light/environment.h"
#include "math/ray.h"
#include "sampling/warp.h"
#include "texture/texture.h"

namespace raykiln {

namespace {

const LightSample no_sample{{0, 0, 1}, {}, false, {}, 0.0f, false};

LightSample towards_point(const Vec3f& p, const Vec3f& position, const Vec3f& intensity) {
    const Vec3f d = position - p;
    const float distance2 = length_squared(d);
    if (distance2 <= 0.0f) {
        return no_sample;
    }
    return {d / sqrt(distance2), position, false, intensity / distance2, 1.0f, true};
}

float spot_falloff(const SpotLight& light, float cosine) {
    const float range = max(light.cos_inner - light.cos_outer, 1e-6f);
    return sqr(clamp((cosine - light.cos_outer) / range, 0.0f, 1.0f));
}

struct Sample {
    const Scene& scene;
    const Vec3f& p;
    float u, v;

    LightSample operator()(const PointLight& light) const {
        return towards_point(p, light.position, light.intensity);
    }

    LightSample operator()(const SpotLight& light) const {
        LightSample s = towards_point(p, light.position, light.intensity);
        s.radiance *= spot_falloff(light, -dot(s.direction, light.axis));
        return s;
    }

    LightSample operator()(const DirectionalLight& light) const {
        return {-light.direction, {}, true, light.irradiance, 1.0f, true};
    }

    LightSample operator()(const EnvironmentLight& light) const {
        float pdf;
        const Vec3f d = sample_environment(light, u, v, pdf);
        if (pdf <= 0.0f) {
            return no_sample;
        }
        return {d, {}, true, environment_radiance(light, scene.textures, d), pdf, false};
    }

    LightSample operator()(const TriangleLight& light) const {
        const Vec2f b = sample_triangle(u, v);
        const Vec3f point = light.p0 + light.edge1 * b.x + light.edge2 * b.y;
        const Vec3f d = point - p;
        const float distance2 = length_squared(d);
        const Vec3f direction = d / sqrt(distance2);
        const float cosine = -dot(direction, light.normal);
        const Vec2f uv{light.uv0.x + (light.uv1.x - light.uv0.x) * b.x +
                           (light.uv2.x - light.uv0.x) * b.y,
                       light.uv0.y + (light.uv1.y - light.uv0.y) * b.x +
                           (light.uv2.y - light.uv0.y) * b.y};
        if (!(distance2 > 0.0f) || cosine == 0.0f) {
            return no_sample;
        }
        const Vec3f radiance = emitted_radiance(scene, light.emission, uv, cosine > 0.0f);
        const float size =
            max_abs(light.p0) + max_abs(light.edge1) + max_abs(light.edge2);
        return {direction,
                offset_origin(point, light.normal, -direction, position_error(size)),
                false,
                radiance,
                pdf_solid_angle_of_area(1.0f / light.area, distance2, std::fabs(cosine)),
                false};
    }

    LightSample operator()(const SphereLight& light) const;
};

/// Uniform within the cone that the sphere fills, seen from outside (Shirley et al.
/// 1996); uniform over its area, seen from within.
LightSample Sample::operator()(const SphereLight& light) const {
    const Vec3f to_center = light.center - p;
    const float distance2 = length_squared(to_center);
    const float radius2 = sqr(light.radius);
    const float error = position_error(max_abs(light.center) + light.radius);
    if (distance2 <= radius2 * 1.0002f) {
        const Vec3f n = sample_sphere(u, v);
        const Vec3f point = light.center + n * light.radius;
        const Vec3f d = point - p;
        const float d2 = length_squared(d);
        const Vec3f direction = d / sqrt(d2);
        const float cosine = -dot(direction, n);
        if (!(d2 > 0.0f) || cosine == 0.0f) {
            return no_sample;
        }
        const float pdf_area = 0.25f * inv_pi / radius2;
        return {
            direction,
            offset_origin(point, n, -direction, error),
            false,
            emitted_radiance(scene, light.emission, {}, (cosine > 0.0f) != light.inward),
            pdf_solid_angle_of_area(pdf_area, d2, std::fabs(cosine)),
            false};
    }
    const float sin2 = radius2 / distance2;
    const float one_minus_cos = sin2 / (1.0f + safe_sqrt(1.0f - sin2));
    const Frame<float> cone = frame_of_normal(to_center / sqrt(distance2));
    const Vec3f direction = normalize(cone.to_world(sample_cone(u, v, one_minus_cos)));
    const float along = dot(to_center, direction);
    const float half_chord = safe_sqrt(radius2 - (distance2 - along * along));
    const Vec3f n = normalize(direction * (along - half_chord) - to_center);
    const Vec3f point = light.center + n * light.radius;
    return {direction,
            offset_origin(point, n, -direction, error),
            false,
            emitted_radiance(scene, light.emission, {}, !light.inward),
            pdf_cone(one_minus_cos),
            false};
}

/// Bounds and power of the lights in the scene; power 0 for those beyond it.
struct BoundsOf {
    const Scene& scene;

    float surface_power(std::uint32_t emission, float area) const {
        const Emission& e = scene.emissions[emission];
        const float sides = e.two_sided ? 2.0f : 1.0f;
        return luminance(average(e.radiance, scene.textures)) * area * pi * sides;
    }
    LightBounds operator()(const PointLight& l) const {
        LightBounds b{{},   4.0f * pi * luminance(l.intensity), {0, 0, 1}, -1.0f, 0.0f,
                      false};
        b.bounds.add(l.position);
        return b;
    }
    LightBounds operator()(const SpotLight& l) const {
        const float solid_angle = two_pi * (1.0f - 0.5f * (l.cos_inner + l.cos_outer));
        LightBounds b{
            {}, solid_angle * luminance(l.intensity), l.axis, 1.0f, l.cos_outer, false};
        b.bounds.add(l.position);
        return b;
    }
    LightBounds operator()(const TriangleLight& l) const {
        LightBounds b{{},   surface_power(l.emission, l.area),    l.normal, 1.0f,
                      0.0f, scene.emissions[l.emission].two_sided};
        b.bounds.add(l.p0);
        b.bounds.add(l.p0 + l.edge1);
        b.bounds.add(l.p0 + l.edge2);
        return b;
    }
    LightBounds operator()(const SphereLight& l) const {
        const float area = 4.0f * pi * sqr(l.radius);
        LightBounds b{{}, surface_power(l.emission, area), {0, 0, 1}, -1.0f, 0.0f, false};
        b.bounds.add(l.center - Vec3f(l.radius));
        b.bounds.add(l.center + Vec3f(l.radius));
        return b;
    }
    LightBounds operator()(const DirectionalLight&) const { return {}; }
    LightBounds operator()(const EnvironmentLight&) const { return {}; }
};

float far_power(const Light& light) {
    if (const auto* environment = std::get_if<EnvironmentLight>(&light)) {
        return environment->power;
    }
    return luminance(std::get<DirectionalLight>(light).irradiance);
}

bool is_infinite(const Light& light) {
    return std::holds_alternative<DirectionalLight>(light) ||
           std::holds_alternative<EnvironmentLight>(light);
}

/// A third vertex order where the map from the group mirrors, so that the normal stays
/// outside.
void add_triangle_lights(Scene& scene, const Mesh& mesh,
                         const Transform& world_from_group) {
    const bool flip = mesh.flip_normals != (world_from_group.determinant() < 0.0f);
    for (std::uint32_t t = 0; t < mesh.triangle_count; ++t) {
        const std::uint32_t* v = mesh.indices + 3 * static_cast<std::size_t>(t);
        TriangleLight light;
        light.p0 = world_from_group.point(mesh.position(v[0]));
        light.edge1 = world_from_group.point(mesh.position(v[1])) - light.p0;
        light.edge2 = world_from_group.point(mesh.position(v[2])) - light.p0;
        const Vec3f normal = cross(light.edge1, light.edge2);
        const float twice_area = length(normal);
        light.area = 0.5f * twice_area;
        light.normal = twice_area > 0.0f ? normal / twice_area : Vec3f(0, 0, 1);
        if (flip) {
            light.normal = -light.normal;
        }
        if (mesh.uvs != nullptr) {
            light.uv0 = mesh.uv(v[0]);
            light.uv1 = mesh.uv(v[1]);
            light.uv2 = mesh.uv(v[2]);
        } else {
            light.uv0 = {0, 0};
            light.uv1 = {1, 0};
            light.uv2 = {0, 1};
        }
        light.emission = mesh.emission;
        scene.lights.emplace_back(light);
    }
}

/// Adds the lights of a group placed once; returns the first light of each geometry.
std::vector<std::uint32_t> add_surface_lights(Scene& scene, const Group& group,
                                              const Transform& world_from_group) {
    std::vector<std::uint32_t> offsets;
    for (const Mesh& mesh : group.meshes) {
        const auto first = static_cast<std::uint32_t>(scene.lights.size());
        offsets.push_back(mesh.emission == no_index ? no_index : first);
        if (mesh.emission != no_index) {
            add_triangle_lights(scene, mesh, world_from_group);
        }
    }
    for (const Sphere& sphere : group.spheres) {
        const auto first = static_cast<std::uint32_t>(scene.lights.size());
        offsets.push_back(sphere.emission == no_index ? no_index : first);
        if (sphere.emission != no_index) {
            // Emissive spheres are only placed by similarities (raykiln/compile.py sees
            // to it).
            const float scale = std::cbrt(std::fabs(world_from_group.determinant()));
            scene.lights.emplace_back(SphereLight{world_from_group.point(sphere.center),
                                                  sphere.radius * scale,
                                                  sphere.flip_normals, sphere.emission});
        }
    }
    return offsets;
}

}  // namespace

LightSample sample_light(const Scene& scene, const Light& light, const Vec3f& p, float u,
                         float v) {
    return std::visit(Sample{scene, p, u, v}, light);
}

float pdf_light(const Light& light, const Vec3f& p, const Vec3f& direction,
                float distance) {
    if (const auto* t = std::get_if<TriangleLight>(&light)) {
        const float cosine = std::fabs(dot(direction, t->normal));
        return cosine > 0.0f
                   ? pdf_solid_angle_of_area(1.0f / t->area, sqr(distance), cosine)
                   : 0.0f;
    }
    if (const auto* s = std::get_if<SphereLight>(&light)) {
        const float distance2 = length_squared(s->center - p);
        const float radius2 = sqr(s->radius);
        if (distance2 <= radius2 * 1.0002f) {
            const Vec3f n = normalize(p + direction * distance - s->center);
            const float cosine = std::fabs(dot(direction, n));
            return cosine > 0.0f ? pdf_solid_angle_of_area(0.25f * inv_pi / radius2,
                                                           sqr(distance), cosine)
                                 : 0.0f;
        }
        const float sin2 = radius2 / distance2;
        return pdf_cone(sin2 / (1.0f + safe_sqrt(1.0f - sin2)));
    }
    return 0.0f;
}

Vec3f emitted_radiance(const Scene& scene, std::uint32_t emission, Vec2f uv, bool front) {
    const Emission& e = scene.emissions[emission];
    if (!front && !e.two_sided) {
        return Vec3f(0.0f);
    }
    return evaluate(e.radiance, scene.textures, uv);
}

void prepare_lights(Scene& scene) {
    for (Light& light : scene.lights) {
        if (auto* environment = std::get_if<EnvironmentLight>(&light)) {
            prepare_environment(*environment, scene.textures);
        }
    }
    scene.light_offset = add_surface_lights(scene, scene.groups[0], Transform{});
    for (const Instance& instance : scene.instances) {
        scene.instance_light_offset.push_back(add_surface_lights(
            scene, scene.groups[instance.group], instance.world_from_group));
    }
    std::vector<LightBounds> near_bounds;
    std::vector<float> far_powers;
    for (std::uint32_t i = 0; i < scene.lights.size(); ++i) {
        near_bounds.push_back(std::visit(BoundsOf{scene}, scene.lights[i]));
        if (is_infinite(scene.lights[i])) {
            scene.far_lights.push_back(i);
            far_powers.push_back(far_power(scene.lights[i]));
        }
    }
    scene.near_lights = LightTree(near_bounds);
    scene.far_choice = AliasTable(far_powers);
    // Power within the scene and irradiance from beyond it do not compare: the choice is
    // even.
    scene.far_share = scene.far_lights.empty()    ? 0.0f
                      : scene.near_lights.empty() ? 1.0f
                                                  : 0.5f;
}

LightTree::Choice choose_light(const Scene& scene, const LightReceiver& receiver,
                               float u) {
    if (u < scene.far_share) {
        float remapped;
        const std::uint32_t i = scene.far_choice.sample(u / scene.far_share, remapped);
        return {scene.far_lights[i], scene.far_share * scene.far_choice.pmf(i)};
    }
    const float rest = (u - scene.far_share) / (1.0f - scene.far_share);
    LightTree::Choice choice = scene.near_lights.sample(receiver, rest);
    choice.pmf *= 1.0f - scene.far_share;
    return choice;
}

float pmf_of_light(const Scene& scene, const LightReceiver& receiver,
                   std::uint32_t light) {
    for (std::uint32_t i = 0; i < scene.far_lights.size(); ++i) {
        if (scene.far_lights[i] == light) {
            return scene.far_share * scene.far_choice.pmf(i);
        }
    }
    return (1.0f - scene.far_share) * scene.near_lights.pmf(receiver, light);
}

}  // namespace raykiln
