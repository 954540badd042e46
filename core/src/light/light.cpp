#include "light/light.h"

#include <cmath>
#include <optional>

#include "light/sample_light.h"

namespace raykiln {

namespace {

template <class... Cases>
struct Overloaded : Cases... {
    using Cases::operator()...;
};

struct Sample {
    const Scene& scene;
    const Vec3f& p;
    const Vec3f& normal;
    float u, v, w;

    LightSample operator()(const PointLight& l) const {
        return sample_toward_point(p, l.position, l.intensity);
    }
    LightSample operator()(const SpotLight& l) const {
        return sample_spot(p, l.position, l.axis, l.intensity, l.cos_inner, l.cos_outer);
    }
    LightSample operator()(const DirectionalLight& l) const {
        return sample_directional(l.direction, l.irradiance);
    }
    LightSample operator()(const EnvironmentLight& l) const {
        return sample_environment_light(scene, l, normal, u, v, w);
    }
    LightSample operator()(const TriangleLight& l) const {
        return sample_triangle_light(scene, l, p, u, v);
    }
    LightSample operator()(const ParallelogramLight& l) const {
        return sample_parallelogram_light(scene, l.half, p, u, v);
    }
    LightSample operator()(const SphereLight& l) const {
        return sample_sphere_light(scene, l, p, u, v);
    }
};

Bounds bounds_of(const SphereLight& l) {
    return {l.center - Vec3f(l.radius), l.center + Vec3f(l.radius)};
}

/// Luminance of each emission, averaged over its texture.
std::vector<float> luminances(const Scene& scene) {
    std::vector<float> all;
    for (const Emission& e : scene.emissions) {
        all.push_back(luminance(average(e.radiance, scene.textures)));
    }
    return all;
}

/// Bounds and power of the lights in the scene; power 0 for those beyond it.
struct BoundsOf {
    const Scene& scene;
    const std::vector<float>& of_emission;  ///< `luminances`

    void set_power(LightBounds& b, std::uint32_t emission, float area) const {
        const Emission& e = scene.emissions[emission];
        const float sides = e.two_sided != 0 ? 2.0f : 1.0f;
        const float radiance = of_emission[emission];
        b.power = radiance * area * pi * sides;
        // What has no power is not chosen, but a texture may shine where the average did
        // not look, or have a number in it that is none.
        if (radiance > 0.0f) {
            b.radiance = radiance;
        } else if (e.radiance.texture != no_texture) {
            b.radiance = 0.0f;
        }
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
        LightBounds b{{},   0.0f, l.normal,
                      1.0f, 0.0f, scene.emissions[l.emission].two_sided != 0};
        set_power(b, l.emission, l.area);
        b.bounds.add(l.p0);
        b.bounds.add(l.p0 + l.edge1);
        b.bounds.add(l.p0 + l.edge2);
        return b;
    }
    LightBounds operator()(const ParallelogramLight& l) const {
        LightBounds b = (*this)(l.half);
        b.power *= 2.0f;
        b.bounds.add(l.half.p0 + l.half.edge1 + l.half.edge2);
        return b;
    }
    LightBounds operator()(const SphereLight& l) const {
        const float area = 4.0f * pi * sqr(l.radius);
        LightBounds b{bounds_of(l), 0.0f, {0, 0, 1}, -1.0f, 0.0f, false};
        set_power(b, l.emission, area);
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
TriangleLight triangle_light(const Mesh& mesh, const Transform& world_from_group,
                             std::uint32_t triangle) {
    const bool flip = mesh.flip_normals != (world_from_group.determinant() < 0.0f);
    const std::uint32_t* v = mesh.indices + 3 * static_cast<std::size_t>(triangle);
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
    return light;
}

/// The same triangle from its next corner on.
TriangleLight turned(const TriangleLight& t) {
    TriangleLight next = t;
    next.p0 = t.p0 + t.edge1;
    next.edge1 = t.edge2 - t.edge1;
    next.edge2 = -t.edge1;
    next.uv0 = t.uv1;
    next.uv1 = t.uv2;
    next.uv2 = t.uv0;
    return next;
}

/// Whether b is a, reflected at the middle of the edge that faces a's first corner: its
/// corners are those of a's other two and the fourth of the parallelogram, to rounding.
bool complete_each_other(const TriangleLight& a, const TriangleLight& b, bool textured) {
    const float size = max_abs(a.p0) + max_abs(a.edge1) + max_abs(a.edge2);
    const float near = 1e-6f * size;
    const Vec3f fourth = a.p0 + a.edge1 + a.edge2;
    if (max_abs(b.p0 - fourth) > near || max_abs(b.edge1 + a.edge1) > near ||
        max_abs(b.edge2 + a.edge2) > near || dot(a.normal, b.normal) < 0.999f) {
        return false;
    }
    const auto follows = [&](float a0, float a1, float a2, float b0, float b1, float b2) {
        const float off =
            std::fabs(b0 - (a1 + a2 - a0)) + std::fabs(b1 - a2) + std::fabs(b2 - a1);
        return off <= 1e-5f * (std::fabs(a0) + std::fabs(a1) + std::fabs(a2) + 1.0f);
    };
    return !textured || (follows(a.uv0.x, a.uv1.x, a.uv2.x, b.uv0.x, b.uv1.x, b.uv2.x) &&
                         follows(a.uv0.y, a.uv1.y, a.uv2.y, b.uv0.y, b.uv1.y, b.uv2.y));
}

/// The light of two triangles that make a parallelogram, if they do.
std::optional<ParallelogramLight> parallelogram(TriangleLight a, TriangleLight b,
                                                bool textured) {
    if (!(a.area > 0.0f)) {
        return std::nullopt;
    }
    for (int i = 0; i < 3; ++i, a = turned(a)) {
        for (int k = 0; k < 3; ++k, b = turned(b)) {
            if (complete_each_other(a, b, textured)) {
                return ParallelogramLight{a};
            }
        }
    }
    return std::nullopt;
}

void add_triangle_lights(Scene& scene, const Mesh& mesh,
                         const Transform& world_from_group) {
    const bool textured = scene.emissions[mesh.emission].radiance.texture != no_texture;
    for (std::uint32_t t = 0; t < mesh.triangle_count; ++t) {
        const auto light = static_cast<std::uint32_t>(scene.lights.size());
        const TriangleLight one = triangle_light(mesh, world_from_group, t);
        scene.surface_lights.push_back(light);
        // Squares and boxes have their two triangles one after the other.
        if (t + 1 < mesh.triangle_count) {
            const auto both = parallelogram(
                one, triangle_light(mesh, world_from_group, t + 1), textured);
            if (both) {
                scene.lights.emplace_back(*both);
                scene.surface_lights.push_back(light);
                ++t;
                continue;
            }
        }
        scene.lights.emplace_back(one);
    }
}

Bounds bounds_of(const Mesh& mesh, const Transform& world_from_group) {
    Bounds bounds;
    for (std::size_t i = 0; i < 3 * std::size_t{mesh.triangle_count}; ++i) {
        bounds.add(world_from_group.point(mesh.position(mesh.indices[i])));
    }
    return bounds;
}

void add_emitter_bounds(Scene& scene, const Bounds& bounds) {
    if (bounds.empty()) {
        return;  // a mesh without triangles
    }
    // Rays meet an instance in its own space, where they are rounded otherwise.
    const Vec3f margin(1e-6f * max(max_abs(bounds.low), max_abs(bounds.high)));
    scene.emitter_bounds.push_back({bounds.low - margin, bounds.high + margin});
}

/// Adds the lights of a group placed once; returns where each geometry begins in
/// `surface_lights`.
std::vector<std::uint32_t> add_surface_lights(Scene& scene, const Group& group,
                                              const Transform& world_from_group) {
    std::vector<std::uint32_t> offsets;
    for (const Mesh& mesh : group.meshes) {
        const auto first = static_cast<std::uint32_t>(scene.surface_lights.size());
        offsets.push_back(mesh.emission == no_index ? no_index : first);
        if (mesh.emission != no_index) {
            add_triangle_lights(scene, mesh, world_from_group);
            add_emitter_bounds(scene, bounds_of(mesh, world_from_group));
        }
    }
    for (const Sphere& sphere : group.spheres) {
        const auto first = static_cast<std::uint32_t>(scene.surface_lights.size());
        offsets.push_back(sphere.emission == no_index ? no_index : first);
        if (sphere.emission != no_index) {
            // Emissive spheres are only placed by similarities (raykiln/compile.py sees
            // to it).
            scene.surface_lights.push_back(
                static_cast<std::uint32_t>(scene.lights.size()));
            const float scale = std::cbrt(std::fabs(world_from_group.determinant()));
            const SphereLight light{world_from_group.point(sphere.center),
                                    sphere.radius * scale, sphere.flip_normals ? 1u : 0u,
                                    sphere.emission};
            scene.lights.emplace_back(light);
            add_emitter_bounds(scene, bounds_of(light));
        }
    }
    return offsets;
}

}  // namespace

LightSample sample_light(const Scene& scene, const Light& light,
                         const LightReceiver& receiver, float u, float v, float w) {
    return std::visit(Sample{scene, receiver.p, receiver.normal, u, v, w}, light);
}

float pdf_light(const Light& light, const Vec3f& p, const Vec3f& direction,
                float distance) {
    if (const auto* t = std::get_if<TriangleLight>(&light)) {
        return pdf_triangle_light(*t, p, direction, distance);
    }
    if (const auto* q = std::get_if<ParallelogramLight>(&light)) {
        return pdf_parallelogram_light(q->half, p, direction, distance);
    }
    if (const auto* s = std::get_if<SphereLight>(&light)) {
        return pdf_sphere_light(s->center, s->radius, p, direction, distance);
    }
    return 0.0f;
}

namespace {

LightTable tabulate(const std::vector<Light>& lights) {
    LightTable table;
    const auto add = [&](auto& of_kind, const auto& light) {
        table.slot.push_back(static_cast<std::uint32_t>(of_kind.size()));
        of_kind.push_back(light);
    };
    for (std::uint32_t i = 0; i < lights.size(); ++i) {
        table.kind.push_back(static_cast<std::uint32_t>(lights[i].index()));
        std::visit(
            Overloaded{
                [&](const PointLight& l) { add(table.points, l); },
                [&](const SpotLight& l) { add(table.spots, l); },
                [&](const DirectionalLight& l) { add(table.directionals, l); },
                [&](const EnvironmentLight&) { add(table.environments, i); },
                [&](const TriangleLight& l) { add(table.triangles, l); },
                [&](const SphereLight& l) { add(table.spheres, l); },
                [&](const ParallelogramLight& l) { add(table.parallelograms, l); }},
            lights[i]);
    }
    return table;
}

/// More boxes would take longer than the rays that they spare.
void join_many(std::vector<Bounds>& bounds) {
    constexpr std::size_t most = 8;
    if (bounds.size() > most) {
        Bounds all;
        for (const Bounds& one : bounds) {
            all.add(one);
        }
        bounds = {all};
    }
}

}  // namespace

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
    join_many(scene.emitter_bounds);
    const std::vector<float> of_emission = luminances(scene);
    std::vector<LightBounds> near_bounds;
    std::vector<float> far_powers;
    for (std::uint32_t i = 0; i < scene.lights.size(); ++i) {
        near_bounds.push_back(std::visit(BoundsOf{scene, of_emission}, scene.lights[i]));
        if (is_infinite(scene.lights[i])) {
            scene.far_lights.push_back(i);
            far_powers.push_back(far_power(scene.lights[i]));
        }
    }
    scene.light_table = tabulate(scene.lights);
    scene.near_lights = LightTree(near_bounds);
    scene.far_choice = AliasTable(far_powers);
    // Power within the scene and irradiance from beyond it do not compare: the choice is
    // even.
    scene.far_share = scene.far_lights.empty()    ? 0.0f
                      : scene.near_lights.empty() ? 1.0f
                                                  : 0.5f;
}

float pmf_of_light(const Scene& scene, const LightReceiver& receiver,
                   std::uint32_t light) {
    for (std::uint32_t i = 0; i < scene.far_lights.size(); ++i) {
        if (scene.far_lights[i] == light) {
            return pmf_of_far_light(scene, i);
        }
    }
    return pmf_of_near_light(scene, receiver, light);
}

}  // namespace raykiln
