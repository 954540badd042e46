#include "light/environment.h"

#include "sampling/warp.h"
#include "texture/texture.h"

namespace raykiln {

namespace {

const Texture& map_of(const EnvironmentLight& light,
                      const std::vector<Texture>& textures) {
    return textures[static_cast<std::size_t>(light.map)];
}

}  // namespace

void prepare_environment(EnvironmentLight& light, const std::vector<Texture>& textures) {
    if (light.map == no_texture) {
        light.power = luminance(light.scale) * 4.0f * pi;
        return;
    }
    const Texture& map = map_of(light, textures);
    const auto& image = std::get<ImageTexture>(map);
    const int width = image.width, height = image.height;
    // A cell's weight is the greatest luminance of the bilinear patch over it, so that no
    // lit direction has density 0.
    std::vector<float> weights(static_cast<std::size_t>(width) *
                               static_cast<std::size_t>(height));
    double power = 0;
    for (int y = 0; y < height; ++y) {
        float sine, cosine;
        const float v = (static_cast<float>(y) + 0.5f) / static_cast<float>(height);
        sin_cos_turns(v * 0.5f, sine, cosine);
        for (int x = 0; x < width; ++x) {
            float peak = 0;
            for (int corner = 0; corner < 9; ++corner) {
                const float cx =
                    static_cast<float>(x) + 0.5f * static_cast<float>(corner % 3);
                const float cy =
                    static_cast<float>(y) + 0.5f * static_cast<float>(corner / 3);
                const Vec2f uv{cx / static_cast<float>(width),
                               cy / static_cast<float>(height)};
                peak = max(peak, luminance(lookup(map, uv).rgb));
            }
            const auto cell =
                static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                static_cast<std::size_t>(x);
            weights[cell] = std::isfinite(peak) ? peak * sine : 0.0f;
            power += weights[cell];
        }
    }
    light.power = static_cast<float>(power * 2.0 * pi * pi /
                                     (static_cast<double>(width) * height)) *
                  luminance(light.scale);
    light.distribution = Distribution2D(weights, width, height);
}

}  // namespace raykiln
