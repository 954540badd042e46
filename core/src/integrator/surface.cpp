#include "integrator/surface.h"

namespace raykiln {

namespace {

TriangleCorners<float> corners_of(const Mesh& mesh, std::uint32_t triangle) {
    const std::uint32_t* v = mesh.indices + 3 * static_cast<std::size_t>(triangle);
    TriangleCorners<float> t;
    for (int i = 0; i < 3; ++i) {
        t.p[i] = mesh.position(v[i]);
        t.n[i] = mesh.normals != nullptr ? mesh.normal(v[i]) : Vec3f{};
        t.uv[i] = mesh.uvs != nullptr ? mesh.uv(v[i]) : Vec2f{};
    }
    t.has_normals = mesh.normals != nullptr;
    t.has_uv = mesh.uvs != nullptr;
    return t;
}

Geometry<float> geometry_of(const ShapeOfHit& shape, const Hit& hit) {
    return shape.mesh != nullptr
               ? triangle_geometry(corners_of(*shape.mesh, hit.primitive), hit.u, hit.v)
               : sphere_geometry(shape.sphere->center, shape.sphere->radius, hit.normal);
}

}  // namespace

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
    return first == no_index ? no_index : scene.surface_lights[first + hit.primitive];
}

Surface make_surface(const Scene& scene, const Hit& hit, const Ray& ray) {
    const ShapeOfHit shape = shape_of(scene, hit);
    Geometry<float> g = geometry_of(shape, hit);
    if (shape.instance != nullptr) {
        g = in_world(g, shape.instance->world_from_group);
    }
    Surface s;
    s.material = &scene.materials[shape.material()];
    static_cast<SurfacePoint<float>&>(s) = surface_point(
        g, shape.flip() ? -1.0f : 1.0f, *s.material, scene.textures, -ray.direction);
    s.emission = shape.emission();
    s.light = s.emission == no_index ? no_index : light_of(scene, hit);
    return s;
}

float opacity_at(const Scene& scene, const Hit& hit) {
    const ShapeOfHit shape = shape_of(scene, hit);
    const Material& material = scene.materials[shape.material()];
    if (!material.has_opacity()) {
        return 1.0f;
    }
    const Vec2f uv = geometry_of(shape, hit).uv;
    const float opacity = evaluate(material.opacity, scene.textures, uv);
    if (material.alpha_cutoff >= 0.0f) {
        return opacity >= material.alpha_cutoff ? 1.0f : 0.0f;
    }
    return clamp(opacity, 0.0f, 1.0f);
}

}  // namespace raykiln
