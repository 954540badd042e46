#include "integrator/surface.h"

#include "math/elementary.h"
#include "texture/texture.h"

namespace raykiln {

namespace {

/// Geometry at a hit, before shading: first in the group's space, then in the world's.
struct Geometry {
    Vec3f p, normal, shading_normal;
    Vec3f dp_du, dp_dv;
    Vec2f uv;
    float magnitude;  // of the coordinates that p was computed from
};

Vec2f uv_at(const Mesh& mesh, const std::uint32_t* v, const Hit& hit) {
    if (mesh.uvs == nullptr) {
        return {hit.u, hit.v};
    }
    const Vec2f a = mesh.uv(v[0]), b = mesh.uv(v[1]), c = mesh.uv(v[2]);
    const float w = 1.0f - hit.u - hit.v;
    return {w * a.x + hit.u * b.x + hit.v * c.x, w * a.y + hit.u * b.y + hit.v * c.y};
}

/// Derivatives of position over texture coordinates; 0 where the mapping is degenerate.
void set_derivatives(Geometry& g, const Mesh& mesh, const std::uint32_t* v,
                     const Vec3f& edge1, const Vec3f& edge2) {
    if (mesh.uvs == nullptr) {
        return;
    }
    const Vec2f a = mesh.uv(v[0]), b = mesh.uv(v[1]), c = mesh.uv(v[2]);
    const float du1 = b.x - a.x, dv1 = b.y - a.y, du2 = c.x - a.x, dv2 = c.y - a.y;
    const float determinant = du1 * dv2 - dv1 * du2;
    if (determinant == 0.0f || !std::isfinite(1.0f / determinant)) {
        return;
    }
    g.dp_du = (edge1 * dv2 - edge2 * dv1) / determinant;
    g.dp_dv = (edge2 * du1 - edge1 * du2) / determinant;
}

Geometry triangle_geometry(const Mesh& mesh, const Hit& hit) {
    const std::uint32_t* v = mesh.indices + 3 * static_cast<std::size_t>(hit.primitive);
    const Vec3f p0 = mesh.position(v[0]), p1 = mesh.position(v[1]),
                p2 = mesh.position(v[2]);
    const float w = 1.0f - hit.u - hit.v;
    Geometry g;
    g.p = p0 * w + p1 * hit.u + p2 * hit.v;
    g.magnitude = max(max_abs(p0), max(max_abs(p1), max_abs(p2)));
    const Vec3f edge1 = p1 - p0, edge2 = p2 - p0;
    g.normal = cross(edge1, edge2);
    g.shading_normal = g.normal;
    if (mesh.normals != nullptr) {
        const Vec3f n =
            mesh.normal(v[0]) * w + mesh.normal(v[1]) * hit.u + mesh.normal(v[2]) * hit.v;
        g.shading_normal = length_squared(n) > 0.0f ? n : g.normal;
    }
    g.uv = uv_at(mesh, v, hit);
    set_derivatives(g, mesh, v, edge1, edge2);
    return g;
}

/// u = 1/2 + atan2(x, z) / 2 pi, v = acos(y) / pi in the sphere's own space.
Geometry sphere_geometry(const Sphere& sphere, const Hit& hit) {
    Geometry g;
    const Vec3f n = normalize(hit.normal);
    g.p = sphere.center + n * sphere.radius;
    g.magnitude = max_abs(sphere.center) + sphere.radius;
    g.normal = g.shading_normal = n;
    g.uv = {0.5f + atan2(n.x, n.z) * inv_two_pi, acos(n.y) * inv_pi};
    const float ring = safe_sqrt(n.x * n.x + n.z * n.z);
    g.dp_du = Vec3f{n.z, 0, -n.x} * (two_pi * sphere.radius);
    g.dp_dv = ring > 0.0f ? Vec3f{n.y * n.x / ring, -ring, n.y * n.z / ring} *
                                (pi * sphere.radius)
                          : Vec3f{};
    return g;
}

void to_world(Geometry& g, const Instance& instance) {
    const Transform& m = instance.world_from_group;
    const float scale = max(length(m.x), max(length(m.y), length(m.z)));
    g.magnitude = g.magnitude * scale * 1.7320508f + max_abs(m.origin);
    g.p = m.point(g.p);
    g.normal = m.normal(g.normal);
    g.shading_normal = m.normal(g.shading_normal);
    g.dp_du = m.vector(g.dp_du);
    g.dp_dv = m.vector(g.dp_dv);
}

struct ShapeOfHit {
    const Mesh* mesh = nullptr;
    const Sphere* sphere = nullptr;
    const Instance* instance = nullptr;

    std::uint32_t material() const {
        return mesh != nullptr ? mesh->material : sphere->material;
    }
    std::uint32_t emission() const {
        return mesh != nullptr ? mesh->emission : sphere->emission;
    }
    bool flip() const {
        return mesh != nullptr ? mesh->flip_normals : sphere->flip_normals;
    }
};

ShapeOfHit shape_of(const Scene& scene, const Hit& hit) {
    ShapeOfHit shape;
    const Group* group = &scene.groups[0];
    if (hit.instance != no_index) {
        shape.instance = &scene.instances[hit.instance];
        group = &scene.groups[shape.instance->group];
    }
    if (hit.geometry < group->meshes.size()) {
        shape.mesh = &group->meshes[hit.geometry];
    } else {
        shape.sphere = &group->spheres[hit.geometry - group->meshes.size()];
    }
    return shape;
}

std::uint32_t light_of(const Scene& scene, const Hit& hit) {
    const auto& offsets = hit.instance == no_index
                              ? scene.light_offset
                              : scene.instance_light_offset[hit.instance];
    const std::uint32_t first = offsets[hit.geometry];
    return first == no_index ? no_index : first + hit.primitive;
}

/// A normal map's perturbation of the shading frame. In the map x runs along u and y
/// against v.
Frame<float> mapped_frame(const Scene& scene, const Material& m, const Geometry& g,
                          const Frame<float>& frame) {
    const Vec3f rgb =
        lookup(scene.textures[static_cast<std::size_t>(m.normal_map)], g.uv).rgb;
    const Vec3f local{(2.0f * rgb.x - 1.0f) * m.normal_scale,
                      (2.0f * rgb.y - 1.0f) * m.normal_scale, 2.0f * rgb.z - 1.0f};
    const Vec3f bitangent = dot(frame.t, g.dp_dv) > 0.0f ? -frame.t : frame.t;
    const Vec3f n =
        frame.s * local.x + bitangent * local.y + frame.n * max(local.z, 1e-3f);
    return frame_of_normal_and_tangent(normalize(n), g.dp_du);
}

/// The side of a two-sided surface that `dir_out` sees: the frame is turned to it, and
/// bent where the shading normal would look away from a viewer on that side.
void face_viewer(Surface& s, const Vec3f& dir_out) {
    Frame<float>& f = s.shading;
    Vec3f n = dot(dir_out, s.normal) < 0.0f ? -f.n : f.n;
    constexpr float least = 1e-3f;
    const float cosine = dot(dir_out, n);
    if (cosine < least) {
        n = normalize(n + dir_out * (least - cosine));
    }
    f = frame_of_normal_and_tangent(n, f.s);
}

}  // namespace

Surface make_surface(const Scene& scene, const Hit& hit, const Ray& ray) {
    const ShapeOfHit shape = shape_of(scene, hit);
    Geometry g = shape.mesh != nullptr ? triangle_geometry(*shape.mesh, hit)
                                       : sphere_geometry(*shape.sphere, hit);
    if (shape.instance != nullptr) {
        to_world(g, *shape.instance);
    }
    const float sign = shape.flip() ? -1.0f : 1.0f;
    Surface s;
    s.p = g.p;
    s.uv = g.uv;
    s.error = position_error(g.magnitude);
    s.normal = normalize(g.normal) * sign;
    s.material = &scene.materials[shape.material()];
    s.emission = shape.emission();
    s.light = s.emission == no_index ? no_index : light_of(scene, hit);
    s.shading = frame_of_normal_and_tangent(normalize(g.shading_normal) * sign, g.dp_du);
    if (s.material->normal_map != no_texture) {
        s.shading = mapped_frame(scene, *s.material, g, s.shading);
    }
    if (s.material->two_sided) {
        face_viewer(s, -ray.direction);
    }
    return s;
}

float opacity_at(const Scene& scene, const Hit& hit) {
    const ShapeOfHit shape = shape_of(scene, hit);
    const Material& material = scene.materials[shape.material()];
    if (!material.has_opacity()) {
        return 1.0f;
    }
    const Vec2f uv =
        shape.mesh != nullptr
            ? uv_at(*shape.mesh,
                    shape.mesh->indices + 3 * static_cast<std::size_t>(hit.primitive),
                    hit)
            : sphere_geometry(*shape.sphere, hit).uv;
    const float opacity = evaluate(material.opacity, scene.textures, uv);
    if (material.alpha_cutoff >= 0.0f) {
        return opacity >= material.alpha_cutoff ? 1.0f : 0.0f;
    }
    return clamp(opacity, 0.0f, 1.0f);
}

}  // namespace raykiln
