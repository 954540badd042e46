#pragma once

#include <cstdint>
#include <vector>

#include "math/bounds.h"

namespace raykiln {

/// Where light comes from and which way it may go: positions within `bounds`, emission
/// within angle `theta_e` of normals that lie within angle `theta_o` of `axis`.
struct LightBounds {
    Bounds bounds;
    float power = 0.0f;
    Vec3f axis{0, 0, 1};
    float cos_theta_o = 1.0f, cos_theta_e = 0.0f;
    bool two_sided = false;
};

/// A point to be lit. With a normal, only light from its side counts; (0, 0, 0) = from
/// all sides.
struct LightReceiver {
    Vec3f p;
    Vec3f normal{0, 0, 0};
};

/// A bounding volume hierarchy over lights for choosing one by its likely contribution,
/// in time logarithmic in their number (Conty Estevez and Kulla 2018, "Importance
/// Sampling of Many Lights with Adaptive Tree Splitting"; single choice with one random
/// number).
class LightTree {
  public:
    struct Choice {
        std::uint32_t light;
        float pmf;  ///< 0: no light reaches the receiver
    };

    LightTree() = default;
    explicit LightTree(const std::vector<LightBounds>& lights);

    bool empty() const { return nodes_.empty(); }
    Choice sample(const LightReceiver& receiver, float u) const;
    /// The probability with which `sample` returns a light.
    float pmf(const LightReceiver& receiver, std::uint32_t light) const;

  private:
    // Children of node i lie at `child` and `child + 1`; a leaf has no child but a light.
    struct Node {
        LightBounds bounds;
        Vec3f center;
        float radius2;
        std::uint32_t child, parent, light;
    };
    static constexpr std::uint32_t none = 0xffffffffu;

    static float importance(const Node& node, const LightReceiver& receiver);
    void make_node(std::uint32_t index, const LightBounds& bounds, std::uint32_t parent);
    void build(std::uint32_t index, std::vector<std::uint32_t>& order, std::size_t begin,
               std::size_t end, const std::vector<LightBounds>& lights);

    std::vector<Node> nodes_;
    std::vector<std::uint32_t> leaf_of_light_;
};

}  // namespace raykiln
