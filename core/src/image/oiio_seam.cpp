#include "image/oiio_seam.h"

#include <mutex>

#include "image/limits.h"

namespace raykiln {

// An attribute that the linked version does not know is refused without harm: the same
// limits are checked again by our own code before pixels are read.
static void set_limits() {
    OIIO::attribute("debug", 0);  // else a library writes to our caller's stderr
    OIIO::attribute("limits:imagesize_MB", static_cast<int>(max_image_bytes >> 20));
    OIIO::attribute("limits:channels", max_image_channels);
    OIIO::attribute("limits:resolution", max_image_side);
    OIIO::geterror();
}

void prepare_oiio() {
    static std::once_flag once;
    std::call_once(once, set_limits);
}

}  // namespace raykiln
