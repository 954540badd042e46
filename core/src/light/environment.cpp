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

Vec3f environment_radiance(const EnvironmentLight& light,
                           const std::vector<Texture>& textures, const Vec3f& direction) {
    if (light.map == no_texture) {
        return light.scale;
    }
    const Vec3f local = light.world_from_light.to_local(direction);
    return light.scale * lookup(map_of(light, textures), uv_of_direction(local)).rgb;
}

float pdf_environment(const EnvironmentLight& light, const Vec3f& direction) {
    if (light.map == no_texture) {
        return 0.25f * inv_pi;
    }
    const Vec3f local = light.world_from_light.to_local(direction);
    const float sine = sine_to_axis(local);
    if (sine <= 0.0f) {
        return 0.0f;
    }
    return light.distribution.pdf(uv_of_direction(local)) / (2.0f * pi * pi * sine);
}

Vec3f sample_environment(const EnvironmentLight& light, float u, float v, float& pdf) {
    if (light.map == no_texture) {
        pdf = 0.25f * inv_pi;
        return light.world_from_light.to_world(sample_sphere(u, v));
    }
    const Vec2f uv = light.distribution.sample(u, v, pdf);
    const Vec3f local = direction_of_uv(uv);
    const float sine = sine_to_axis(local);
    pdf = sine > 0.0f ? pdf / (2.0f * pi * pi * sine) : 0.0f;
    return light.world_from_light.to_world(local);
}

}  // namespace raykiln
