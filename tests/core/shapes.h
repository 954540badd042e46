#pragma once

#include <array>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "directions.h"
#include "math/elementary.h"
#include "scene/scene.h"

// Scenes made by code, for the proofs of accel/, integrator/surface and light/.

namespace raykiln::test {

struct Triangles {
    std::vector<Vec3f> positions;
    std::vector<std::array<std::uint32_t, 3>> faces;
    std::vector<Vec2f> uvs;
    std::vector<Vec3f> normals;
};

/// A mesh that owns copies of the arrays.
inline Mesh make_mesh(const Triangles& t) {
    auto positions = std::make_shared<std::vector<float>>();
    for (const Vec3f& p : t.positions) {
        positions->insert(positions->end(), {p.x, p.y, p.z});
    }
    positions->push_back(0.0f);  // 4 readable bytes past the end
    auto indices = std::make_shared<std::vector<std::uint32_t>>();
    for (const auto& face : t.faces) {
        indices->insert(indices->end(), face.begin(), face.end());
    }
    Mesh mesh;
    mesh.positions = positions->data();
    mesh.indices = indices->data();
    mesh.vertex_count = static_cast<std::uint32_t>(t.positions.size());
    mesh.triangle_count = static_cast<std::uint32_t>(t.faces.size());
    mesh.owners = {positions, indices};
    if (!t.uvs.empty()) {
        auto uvs = std::make_shared<std::vector<float>>();
        for (const Vec2f& uv : t.uvs) {
            uvs->insert(uvs->end(), {uv.x, uv.y});
        }
        mesh.uvs = uvs->data();
        mesh.owners.push_back(uvs);
    }
    if (!t.normals.empty()) {
        auto normals = std::make_shared<std::vector<float>>();
        for (const Vec3f& n : t.normals) {
            normals->insert(normals->end(), {n.x, n.y, n.z});
        }
        mesh.normals = normals->data();
        mesh.owners.push_back(normals);
    }
    return mesh;
}

/// A closed mesh about `center`: an icosahedron, each face cut in four `levels` times.
/// `bumps`: by what share the distance of a vertex varies.
inline Triangles make_ball(int levels, const Vec3f& center, float radius, float bumps,
                           Rng& rng) {
    const float a = 0.525731112f, b = 0.850650808f;
    std::vector<Vec3f> p{{-a, 0, b}, {a, 0, b},  {-a, 0, -b}, {a, 0, -b},
                         {0, b, a},  {0, b, -a}, {0, -b, a},  {0, -b, -a},
                         {b, a, 0},  {-b, a, 0}, {b, -a, 0},  {-b, -a, 0}};
    std::vector<std::array<std::uint32_t, 3>> faces{
        {0, 1, 4}, {0, 4, 9},  {9, 4, 5},  {4, 8, 5},  {4, 1, 8},  {8, 1, 10}, {8, 10, 3},
        {5, 8, 3}, {5, 3, 2},  {2, 3, 7},  {7, 3, 10}, {7, 10, 6}, {7, 6, 11}, {11, 6, 0},
        {0, 6, 1}, {6, 10, 1}, {9, 11, 0}, {9, 2, 11}, {9, 5, 2},  {7, 11, 2}};
    for (int level = 0; level < levels; ++level) {
        std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles;
        const auto middle = [&](std::uint32_t i, std::uint32_t j) {
            const auto [at, added] = middles.try_emplace(
                std::minmax(i, j), static_cast<std::uint32_t>(p.size()));
            if (added) {
                p.push_back(normalize(p[i] + p[j]));
            }
            return at->second;
        };
        std::vector<std::array<std::uint32_t, 3>> finer;
        for (const auto& [i, j, k] : faces) {
            const auto ij = middle(i, j), jk = middle(j, k), ki = middle(k, i);
            finer.insert(finer.end(),
                         {{i, ij, ki}, {j, jk, ij}, {k, ki, jk}, {ij, jk, ki}});
        }
        faces = std::move(finer);
    }
    for (Vec3f& v : p) {
        v = center + v * (radius * rng.between(1.0f - bumps, 1.0f + bumps));
    }
    return {std::move(p), std::move(faces), {}, {}};
}

/// Unrelated triangles in the cube from -1 to 1.
inline Triangles make_soup(std::uint32_t count, float size, Rng& rng) {
    Triangles t;
    for (std::uint32_t i = 0; i < count; ++i) {
        const Vec3f at = random_point(rng, 1.0f);
        for (int corner = 0; corner < 3; ++corner) {
            t.positions.push_back(at + random_point(rng, size));
        }
        t.faces.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    return t;
}

/// A rotation by a random angle about a random axis (Rodrigues), times a scale an axis.
inline Transform random_placement(const Vec3f& scale, const Vec3f& origin, Rng& rng) {
    const Vec3f axis = random_direction(rng);
    float sine, cosine;
    sin_cos_turns(rng.unit(), sine, cosine);
    const auto turned = [&](const Vec3f& v) {
        return v * cosine + cross(axis, v) * sine + axis * (dot(axis, v) * (1 - cosine));
    };
    return {turned({1, 0, 0}) * scale.x, turned({0, 1, 0}) * scale.y,
            turned({0, 0, 1}) * scale.z, origin};
}

inline Instance make_instance(std::uint32_t group, const Transform& world_from_group) {
    return {group, world_from_group, inverse_linear(world_from_group)};
}

/// One white diffuse material, for scenes whose shading does not matter.
inline void add_white(Scene& scene) {
    Material material;
    material.kind = DiffuseMaterial{};
    scene.materials.push_back(material);
}

}  // namespace raykiln::test
