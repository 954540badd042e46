#pragma once

// Included by src/image only: nothing else may see libpng.

#include <png.h>

#include <string>

namespace raykiln {

/// Where libpng leaves the complaint with which it jumps out of a call.
struct PngComplaint {
    char text[200] = "";
};

/// For `png_create_*_struct`: keep the message and jump.  Every call of libpng that can
/// fail stands behind a `setjmp(png_jmpbuf(...))`, in a function that has no objects to
/// destroy: the jump would pass their destructors by.
[[noreturn]] void png_fail(png_structp png, png_const_charp message);
void png_ignore(png_structp png, png_const_charp message);

}  // namespace raykiln
