#pragma once

// Included by src/image only: nothing else may see OpenImageIO.

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <string>

namespace raykiln {

/// Tighten OpenImageIO's process-wide limits once; every entry of this folder calls it
/// first.
void prepare_oiio();

/// `message` without the file's name (not empty), which callers add in their own way.
std::string without_name(std::string message, const std::string& name);

/// The first line of an OpenImageIO message, or of `fallback` if it said nothing.
std::string one_line(const std::string& message, const char* fallback);

}  // namespace raykiln
