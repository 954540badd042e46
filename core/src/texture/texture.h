#pragma once

#include "scene/scene.h"

namespace raykiln {

/// Four channels at a texture coordinate; colours linear, alpha 1 where the image has
/// none.
struct Texel {
    Vec3f rgb;
    float alpha;
};

Texel lookup(const Texture& texture, Vec2f uv);

/// Value of a parameter at a texture coordinate.
Vec3f evaluate(const ColorSlot& slot, const std::vector<Texture>& textures, Vec2f uv);
float evaluate(const FloatSlot& slot, const std::vector<Texture>& textures, Vec2f uv);

/// Mean of a parameter over its texture (an estimate, for choosing lights by their
/// power).
Vec3f average(const ColorSlot& slot, const std::vector<Texture>& textures);

}  // namespace raykiln
