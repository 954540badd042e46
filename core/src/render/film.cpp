#include "render/film.h"

#include <algorithm>

namespace raykiln {

namespace {

void add3(std::vector<float>& plane, std::size_t pixel, const Vec3f& v) {
    plane[3 * pixel] += v.x;
    plane[3 * pixel + 1] += v.y;
    plane[3 * pixel + 2] += v.z;
}

}  // namespace

Film::Film(int width, int height, FilmLayers layers) :
    width_(width),
    height_(height),
    layers_(layers) {
    const std::size_t n =
        static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
    radiance_.resize(3 * n);
    luminance_squared_.resize(n);
    counts_.resize(n);
    albedo_.resize(layers.albedo ? 3 * n : 0);
    normal_.resize(layers.normal ? 3 * n : 0);
    depth_.resize(layers.depth ? n : 0);
    depth_weight_.resize(layers.depth ? n : 0);
}

void Film::add(int x, int y, const PixelSums& sums, std::uint32_t count) {
    const std::size_t i = index(x, y);
    add3(radiance_, i, sums.radiance);
    luminance_squared_[i] += sums.luminance_squared;
    if (layers_.albedo) {
        add3(albedo_, i, sums.albedo);
    }
    if (layers_.normal) {
        add3(normal_, i, sums.normal);
    }
    if (layers_.depth) {
        depth_[i] += sums.depth;
        depth_weight_[i] += sums.depth_weight;
    }
    counts_[i] = count;
}

std::uint32_t next_pass(std::uint32_t samples, std::uint32_t spp) {
    constexpr std::uint32_t run = 16;
    // The first sample comes alone, for a picture at once.
    const std::uint32_t end = samples == 0 ? 1 : (samples / run + 1) * run;
    return std::min(end, spp);
}

}  // namespace raykiln
