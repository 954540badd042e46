#pragma once

#include <vector>

#include "scene/scene.h"

namespace raykiln {

/// All that shading needs of a mesh or sphere, found with one index.
struct ShapeRecord {
    const float* positions;
    const std::uint32_t* indices;
    const float* normals;  ///< or null
    const float* uvs;      ///< or null
    const Sphere* sphere;  ///< or null: a mesh
    std::uint32_t material, emission;
    float sign;  ///< -1: normals are flipped
    std::uint32_t vertex_count, triangle_count;
    bool by_gather;  ///< a mesh of at least two triangles whose numbers 31 bits count
};

/// The shapes of all groups in one list.
struct ShapeList {
    std::vector<ShapeRecord> shapes;
    std::vector<std::uint32_t> material_of_shape;
    std::vector<bool> emissive_material;           ///< of some shape that emits
    std::vector<std::uint32_t> first_of_instance;  ///< its first shape

    explicit ShapeList(const Scene& scene) {
        std::vector<std::uint32_t> first_of_group;
        for (const Group& group : scene.groups) {
            first_of_group.push_back(static_cast<std::uint32_t>(shapes.size()));
            for (const Mesh& m : group.meshes) {
                constexpr std::uint32_t most = 0x7fffffffu / 3;
                shapes.push_back({m.positions, m.indices, m.normals, m.uvs, nullptr,
                                  m.material, m.emission, m.flip_normals ? -1.0f : 1.0f,
                                  m.vertex_count, m.triangle_count,
                                  m.triangle_count >= 2 && m.vertex_count >= 2 &&
                                      m.triangle_count <= most &&
                                      m.vertex_count <= most});
            }
            for (const Sphere& s : group.spheres) {
                shapes.push_back({nullptr, nullptr, nullptr, nullptr, &s, s.material,
                                  s.emission, s.flip_normals ? -1.0f : 1.0f, 0, 0,
                                  false});
            }
        }
        emissive_material.resize(scene.materials.size());
        for (const ShapeRecord& shape : shapes) {
            material_of_shape.push_back(shape.material);
            if (shape.emission != no_index) {
                emissive_material[shape.material] = true;
            }
        }
        for (const Instance& instance : scene.instances) {
            first_of_instance.push_back(first_of_group[instance.group]);
        }
    }
};

}  // namespace raykiln
