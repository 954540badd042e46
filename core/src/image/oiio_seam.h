#pragma once

// Included by src/image only: nothing else may see OpenImageIO.

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

namespace raykiln {

/// Tighten OpenImageIO's process-wide limits once; every entry of this folder calls it
/// first.
void prepare_oiio();

}  // namespace raykiln
