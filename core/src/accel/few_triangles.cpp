#include "accel/few_triangles.h"

#include <algorithm>
#include <array>
#include <map>

namespace raykiln {

namespace {

/// Numbers the different keys in the order in which they come.
template <class Key>
class Numbering {
  public:
    std::uint32_t operator[](const Key& key) {
        return number_of_.try_emplace(key, static_cast<std::uint32_t>(number_of_.size()))
            .first->second;
    }
    std::size_t size() const { return number_of_.size(); }

  private:
    std::map<Key, std::uint32_t> number_of_;
};

}  // namespace

FewTriangles::FewTriangles(const Scene& scene) {
    if (!scene.instances.empty() || scene.sphere_count() > 0 ||
        scene.triangle_count() > most) {
        return;
    }
    Numbering<std::array<float, 3>> vertex_at;
    Numbering<std::array<std::uint32_t, 2>> edge_between;
    const std::vector<Mesh>& meshes = scene.groups[0].meshes;
    for (std::uint32_t g = 0; g < meshes.size(); ++g) {
        const Mesh& mesh = meshes[g];
        for (std::uint32_t i = 0; i < mesh.triangle_count; ++i) {
            Vec3f p[3];
            for (int k = 0; k < 3; ++k) {
                p[k] = mesh.position(mesh.indices[3 * i + k]);
            }
            const Vec3f normal = cross(p[1] - p[0], p[2] - p[0]);
            if (!(length_squared(normal) > 0.0f)) {
                continue;  // it has no area
            }
            std::uint32_t corner[3];
            for (int k = 0; k < 3; ++k) {
                // Adding 0 makes one of -0 and +0.
                corner[k] = vertex_at[{p[k].x + 0.0f, p[k].y + 0.0f, p[k].z + 0.0f}];
                if (corner[k] == vertices.size()) {
                    vertices.push_back(p[k]);
                }
            }
            Triangle t{{}, {}, p[0], normal};
            for (int k = 0; k < 3; ++k) {
                const std::uint32_t a = corner[(k + 1) % 3], b = corner[(k + 2) % 3];
                const Edge edge{std::min(a, b), std::max(a, b)};
                t.edge[k] = edge_between[{edge.a, edge.b}];
                t.flip[k] = a < b ? 0u : 0x80000000u;
                if (t.edge[k] == edges.size()) {
                    edges.push_back(edge);
                }
            }
            triangles.push_back(t);
            geometry.push_back(g);
            primitive.push_back(i);
        }
    }
}

}  // namespace raykiln
