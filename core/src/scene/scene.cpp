#include "scene/scene.h"

namespace raykiln {

namespace {

std::uint64_t triangles_of(const Group& group) {
    std::uint64_t count = 0;
    for (const Mesh& mesh : group.meshes) {
        count += mesh.triangle_count;
    }
    return count;
}

}  // namespace

std::uint64_t Scene::triangle_count() const {
    std::uint64_t count = triangles_of(groups[0]);
    for (const Instance& instance : instances) {
        count += triangles_of(groups[instance.group]);
    }
    return count;
}

std::uint64_t Scene::sphere_count() const {
    std::uint64_t count = groups[0].spheres.size();
    for (const Instance& instance : instances) {
        count += groups[instance.group].spheres.size();
    }
    return count;
}

}  // namespace raykiln
