#pragma once

#include <memory>
#include <string>

#include "accel/packet.h"
#include "math/ray.h"
#include "scene/scene.h"

namespace raykiln {

/// What a ray met.
struct Hit {
    float t = infinity;
    float u = 0, v = 0;  ///< barycentric coordinates of the second and third vertex
    Vec3f normal;        ///< geometric, not normalised, in the group's space
    std::uint32_t geometry = no_index;  ///< within its group: meshes first, then spheres
    std::uint32_t primitive = no_index;
    std::uint32_t instance = no_index;  ///< index into Scene::instances, or no_index

    bool valid() const { return geometry != no_index; }
};

/// Bounding volume hierarchies over a scene (Embree). The scene must outlive it
/// unchanged. Safe to use from many threads at once.
class Accel {
  public:
    /// Builds; throws RenderError if memory runs out, SettingsError if `process_isa`
    /// does.
    explicit Accel(const Scene& scene);
    ~Accel();
    Accel(const Accel&) = delete;
    Accel& operator=(const Accel&) = delete;

    Hit intersect(const Ray& ray) const;
    bool occluded(const Ray& ray) const;

    /// The same for N = 4, 8 or 16 rays at once. `coherent`: they start and go nearly
    /// alike. Instances are numbered as in Scene::instances, no_index for none. A lane's
    /// result does not depend on the other lanes, but for which of two surfaces at
    /// exactly the same distance is met.
    template <int N>
    void intersect(RayPacket<N>& packet, bool coherent) const;
    template <int N>
    void occluded(RayPacket<N>& packet) const;
    Bounds bounds() const;
    /// Bytes that the ray tracer has allocated.
    std::size_t memory_bytes() const;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace raykiln
