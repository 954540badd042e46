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
};

/// The shapes of all groups in one list.
struct ShapeList {
    std::vector<ShapeRecord> shapes;
    std::vector<std::uint32_t> material_of_shape;
    std::vector<std::uint32_t> first_of_instance;  ///< its first shape

    explicit ShapeList(const Scene& scene) {
        std::vector<std::uint32_t> first_of_group;
        for (const Group& group : scene.groups) {
            first_of_group.push_back(static_cast<std::uint32_t>(shapes.size()));
            for (const Mesh& m : group.meshes) {
                shapes.push_back({m.positions, m.indices, m.normals, m.uvs, nullptr,
                                  m.material, m.emission, m.flip_normals ? -1.0f : 1.0f});
            }
            for (const Sphere& s : group.spheres) {
                shapes.push_back({nullptr, nullptr, nullptr, nullptr, &s, s.material,
                                  s.emission, s.flip_normals ? -1.0f : 1.0f});
            }
        }
        for (const ShapeRecord& shape : shapes) {
            material_of_shape.push_back(shape.material);
        }
        for (const Instance& instance : scene.instances) {
            first_of_instance.push_back(first_of_group[instance.group]);
        }
    }
};

}  // namespace raykiln
