#pragma once

#include <span>

#include "guide/caustic_guide.h"
#include "integrator/context.h"
#include "light/light.h"

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
    /// Rays from lights to points of smooth surfaces: from number `first` on of `total`,
    /// which stand in the order of the surfaces and are spread evenly over their area.
    void emit(std::uint32_t seed, std::size_t first, std::size_t total,
              std::span<Emitted> rays) const;

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
        /// Of a mesh, by triangles here and there: it decides how many rays go to it, and
        /// about as many serve as well.
        float estimated_area() const;
    };
    /// Where a ray is sent to; `area`: what the point stands for, 0: there is none.
    struct Aim {
        Vec3f p, normal;
        float area = 0.0f;
    };
    Aim aim(double place, const SampleKey<float>& key) const;
    Emitted emitted(const Aim& aim, std::uint32_t light, float pmf,
                    const LightSample& sample) const;
    void add_targets(const Group& group, const Transform& world_from_group);

    const Scene& scene_;
    std::vector<Target> targets_;
    std::vector<double> area_up_to_;  // and with each target
    float area_ = 0.0f;
    float far_distance_ = 0.0f;
};

/// Rays, by their numbers in ascending order, that stand for one power each: those of
/// great power are named several times. As many as have power, and at most `most`.
std::vector<std::uint32_t> equal_in_power(const std::vector<Emitted>& rays,
                                          std::size_t most);

/// Follows a ray from a light over smooth surfaces, and appends a photon where it meets
/// one that a guide may help.
void trace_photon(const Context& c, Ray ray, std::vector<Photon>& photons);

}  // namespace raykiln
