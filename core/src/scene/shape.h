#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "math/transform.h"

namespace raykiln {

constexpr std::uint32_t no_index = 0xffffffffu;

/// Indexed triangles. The arrays belong to `owners` (NumPy arrays, or copies); they are
/// shared with the ray tracer. `positions` must be readable 4 bytes past its end.
struct Mesh {
    const float* positions = nullptr;        ///< 3 a vertex
    const std::uint32_t* indices = nullptr;  ///< 3 a triangle
    const float* normals = nullptr;          ///< 3 a vertex, or null: face normals
    const float* uvs = nullptr;              ///< 2 a vertex, or null
    std::uint32_t vertex_count = 0;
    std::uint32_t triangle_count = 0;
    std::vector<std::shared_ptr<const void>> owners;
    std::uint32_t material = 0;
    std::uint32_t emission = no_index;
    bool flip_normals = false;

    Vec3f position(std::uint32_t v) const {
        return {positions[3 * v], positions[3 * v + 1], positions[3 * v + 2]};
    }
    Vec3f normal(std::uint32_t v) const {
        return {normals[3 * v], normals[3 * v + 1], normals[3 * v + 2]};
    }
    Vec2f uv(std::uint32_t v) const { return {uvs[2 * v], uvs[2 * v + 1]}; }
};

struct Sphere {
    Vec3f center;
    float radius = 1.0f;
    std::uint32_t material = 0;
    std::uint32_t emission = no_index;
    bool flip_normals = false;
};

/// Shapes with one coordinate system. Geometry ids count the meshes first, then the
/// spheres.
struct Group {
    std::vector<Mesh> meshes;
    std::vector<Sphere> spheres;

    std::uint32_t geometry_count() const {
        return static_cast<std::uint32_t>(meshes.size() + spheres.size());
    }
};

struct Instance {
    std::uint32_t group = 0;  ///< index into Scene::groups, never 0
    Transform world_from_group;
    Transform group_from_world_linear;
};

}  // namespace raykiln
