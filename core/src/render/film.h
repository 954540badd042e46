#pragma once

#include <cstdint>
#include <vector>

#include "math/vec.h"

namespace raykiln {

/// Which layers a film holds beside the image.
struct FilmLayers {
    bool albedo = false, normal = false, depth = false;
};

/// The sums of one pixel's samples over a run of sample numbers, added in their order.
struct PixelSums {
    Vec3f radiance;
    float luminance_squared = 0.0f;
    Vec3f albedo, normal;
    float depth = 0.0f, depth_weight = 0.0f;

    /// A sample that is not finite is left out and counted.
    void add_radiance(const Vec3f& sample, std::uint64_t& nonfinite) {
        if (!is_finite(sample)) {
            ++nonfinite;
            return;
        }
        radiance += sample;
        luminance_squared += sqr(luminance(sample));
    }
    void add_first_hit(const Vec3f& surface_albedo, const Vec3f& surface_normal,
                       float surface_depth) {
        albedo += surface_albedo;
        normal += surface_normal;
        depth += surface_depth;
        depth_weight += 1.0f;
    }
};

/// Sums over samples, a pixel each. A pixel's samples are summed by fixed runs (see
/// `next_pass`), and the runs in order, so that the bits do not depend on how a render
/// was cut up.
class Film {
  public:
    Film(int width, int height, FilmLayers layers);

    /// Adds a run of samples that brings the pixel's count to `count`.
    void add(int x, int y, const PixelSums& sums, std::uint32_t count);
    std::uint32_t count(int x, int y) const { return counts_[index(x, y)]; }

    int width() const { return width_; }
    int height() const { return height_; }
    FilmLayers layers() const { return layers_; }

    // The sums themselves, row by row; empty if the layer is not held. For checkpoints.
    std::vector<float>& radiance() { return radiance_; }
    std::vector<float>& luminance_squared() { return luminance_squared_; }
    std::vector<float>& albedo() { return albedo_; }
    std::vector<float>& normal() { return normal_; }
    std::vector<float>& depth() { return depth_; }
    std::vector<float>& depth_weight() { return depth_weight_; }
    std::vector<std::uint32_t>& counts() { return counts_; }

  private:
    std::size_t index(int x, int y) const {
        return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
               static_cast<std::size_t>(x);
    }

    int width_, height_;
    FilmLayers layers_;
    std::vector<float> radiance_, luminance_squared_, albedo_, normal_, depth_,
        depth_weight_;
    std::vector<std::uint32_t> counts_;
};

/// Sample number that the pass after `samples` ends at: 1, 16, then every 16.
std::uint32_t next_pass(std::uint32_t samples, std::uint32_t spp);

}  // namespace raykiln
