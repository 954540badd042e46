#pragma once

#include "math/frame.h"

namespace raykiln {

/// A pinhole camera: it looks along -z of its frame, +x to the right of the image, +y up.
struct Camera {
    Vec3f origin;
    Frame<float> world_from_camera{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};  ///< columns x, y, z
    float tan_half_x = 1, tan_half_y = 1;
    float offset_x = 0, offset_y = 0;  ///< principal point, in image widths and heights
    float near = 0, far = infinity;    ///< along the view axis
};

}  // namespace raykiln
