#pragma once

#include "guide/caustic_guide.h"
#include "integrator/context.h"

namespace raykiln {

/// A ray from a light at a smooth surface, and the power that it stands for.
struct Emitted {
    Ray ray;
    float power = 0.0f;
    float density = 0.0f;  ///< of its direction over solid angle, among all lights
};

/// Sends light at the smooth surfaces of a scene and follows what they focus.
class PhotonSource {
  public:
    explicit PhotonSource(const Scene& scene);

    /// Nothing to send: no smooth surface, or no light.
    bool empty() const { return targets_.empty(); }
    /// Square metres of smooth surfaces.
    float area() const { return area_; }
    /// Number `index` of the rays, from a light to a point of a smooth surface.
    Emitted emit(const SampleKey<float>& key) const;

  private:
    struct Triangle {
        Vec3f p, edge1, edge2;
        Vec3f normal;  // as long as twice the area
    };
    /// A mesh or a sphere in its place.
    struct Target {
        const Mesh* mesh;
        const Sphere* sphere;
        Transform world_from_group;
        float area = 0.0f;  // square metres

        Triangle triangle(std::uint32_t number) const;
    };
    void add_targets(const Group& group, const Transform& world_from_group);

    const Scene& scene_;
    std::vector<Target> targets_;
    AliasTable choice_;
    float area_ = 0.0f;
    float far_distance_ = 0.0f;
};

/// As many of the rays again, by their numbers, that stand for one power each: those of
/// great power often. None if there is no power at all.
std::vector<std::uint32_t> equal_in_power(const std::vector<Emitted>& rays);

/// Follows a ray from a light over smooth surfaces, and appends a photon where it meets
/// one that a guide may help.
void trace_photon(const Context& c, Ray ray, std::vector<Photon>& photons);

}  // namespace raykiln
