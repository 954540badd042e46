#include "light/environment.h"

#include "sampling/warp.h"
#include "texture/texture.h"

namespace raykiln {

namespace {

/// Directions over a block, its edges included, and what each is of its solid angle.
struct Directions {
    static constexpr std::size_t side = 4, count = side * side;
    float x[count], y[count], z[count], share[count];
};

Directions directions_of_block(float left, float right, float top, float bottom) {
    Directions d;
    float sum = 0;
    for (std::size_t i = 0; i < Directions::count; ++i) {
        const auto place = [&](std::size_t at) {
            return static_cast<float>(at) / static_cast<float>(Directions::side - 1);
        };
        const Vec2f uv{lerp(left, right, place(i % Directions::side)),
                       lerp(top, bottom, place(i / Directions::side))};
        const Vec3f direction = direction_of_uv(uv);
        d.x[i] = direction.x;
        d.y[i] = direction.y;
        d.z[i] = direction.z;
        d.share[i] = sine_to_axis(direction);
        sum += d.share[i];
    }
    for (float& share : d.share) {
        share /= sum;
    }
    return d;
}

std::vector<Directions> directions_of_blocks(const BlockDistribution& blocks, int width,
                                             int height) {
    const auto edge = [](std::uint32_t cell, int cells) {
        return static_cast<float>(cell) / static_cast<float>(cells);
    };
    const auto& xs = blocks.column_starts();
    const auto& ys = blocks.row_starts();
    std::vector<Directions> all;
    for (std::size_t row = 0; row < blocks.block_rows(); ++row) {
        for (std::size_t column = 0; column < blocks.block_columns(); ++column) {
            all.push_back(
                directions_of_block(edge(xs[column], width), edge(xs[column + 1], width),
                                    edge(ys[row], height), edge(ys[row + 1], height)));
        }
    }
    return all;
}

/// The mean over a block of what a surface makes of light by its cosine.
float mean_cosine(const Directions& d, const Vec3f& normal) {
    float sum = 0;
    for (std::size_t i = 0; i < Directions::count; ++i) {
        const float cosine = d.x[i] * normal.x + d.y[i] * normal.y + d.z[i] * normal.z;
        sum += max(cosine, 0.0f) * d.share[i];
    }
    return sum;
}

Vec3f normal_of_view(std::uint32_t view) {
    const auto place = [](std::uint32_t vertex) {
        return static_cast<float>(vertex) / static_cast<float>(normal_steps) - 1.0f;
    };
    float x = place(view % normal_side), z = place(view / normal_side);
    const float y = 1.0f - std::fabs(x) - std::fabs(z);
    if (y < 0.0f) {
        const float unfolded = std::copysign(1.0f - std::fabs(z), x);
        z = std::copysign(1.0f - std::fabs(x), z);
        x = unfolded;
    }
    return normalize(Vec3f(x, y, z));
}

/// The least that the cosine counts, so that no light is left out by rounding. It is
/// small: a sun can be a thousand times the rest of the sky.
constexpr float least_cosine = 0.002f;

void add_views(BlockDistribution& distribution, int width, int height) {
    const std::vector<double> masses = distribution.masses();
    const auto directions = directions_of_blocks(distribution, width, height);
    std::vector<double> weights(masses.size());
    for (std::uint32_t view = 0; view < normal_side * normal_side; ++view) {
        const Vec3f normal = normal_of_view(view);
        for (std::size_t block = 0; block < masses.size(); ++block) {
            weights[block] =
                masses[block] * (mean_cosine(directions[block], normal) + least_cosine);
        }
        distribution.add_view(weights);
    }
    distribution.add_view(masses);
}

/// The luminances of row y of texels, with one beyond either end.
void luminances_of_row(const ImageTexture& map, int y, std::vector<float>& row) {
    for (std::size_t i = 0; i < row.size(); ++i) {
        row[i] = luminance(texel(map, static_cast<int>(i) - 1, y).rgb);
    }
}

/// The greatest value over a texel of a line that goes straight from one texel's middle
/// to the next one's.
float peak_along(const float* at) {
    const float higher = max(at[-1], at[1]);
    return *at + 0.5f * max(higher - *at, 0.0f);
}

/// For each texel the greatest luminance of the bilinear patches over it, so that no lit
/// direction has a density of 0, times the sine of its angle to the axis.
std::vector<float> weights_of_texels(const ImageTexture& map) {
    const auto width = static_cast<std::size_t>(map.width);
    std::vector<float> weights(width * static_cast<std::size_t>(map.height));
    // Rows of texels, and the edges between them above and below the one at hand.
    std::vector<float> here(width + 2), below(here), top(here), bottom(here);
    const auto fill_below = [&](int y) {
        luminances_of_row(map, y, below);
        for (std::size_t x = 0; x < below.size(); ++x) {
            bottom[x] = 0.5f * (here[x] + below[x]);
        }
    };
    luminances_of_row(map, -1, here);
    fill_below(0);
    for (int y = 0; y < map.height; ++y) {
        std::swap(here, below);
        std::swap(top, bottom);
        fill_below(y + 1);
        float sine, cosine;
        sin_cos_turns(
            (static_cast<float>(y) + 0.5f) / static_cast<float>(map.height) * 0.5f, sine,
            cosine);
        float* row = &weights[static_cast<std::size_t>(y) * width];
        for (std::size_t x = 0; x < width; ++x) {
            const float peak =
                max(peak_along(&here[x + 1]),
                    max(peak_along(&top[x + 1]), peak_along(&bottom[x + 1])));
            row[x] = std::isfinite(peak) ? max(peak, 0.0f) * sine : 0.0f;
        }
    }
    return weights;
}

}  // namespace

void prepare_environment(EnvironmentLight& light, const std::vector<Texture>& textures) {
    if (light.map == no_texture) {
        light.power = luminance(light.scale) * 4.0f * pi;
        return;
    }
    const auto& map =
        std::get<ImageTexture>(textures[static_cast<std::size_t>(light.map)]);
    const std::vector<float> weights = weights_of_texels(map);
    double power = 0;
    for (const float weight : weights) {
        power += weight;
    }
    const auto texels = static_cast<double>(weights.size());
    light.power =
        static_cast<float>(power * 2.0 * pi * pi / texels) * luminance(light.scale);
    light.distribution = BlockDistribution(weights, map.width, map.height);
    add_views(light.distribution, map.width, map.height);
}

}  // namespace raykiln
