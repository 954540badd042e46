#include "image/png_seam.h"

#include <cstring>

namespace raykiln {

void png_fail(png_structp png, png_const_charp message) {
    auto* complaint = static_cast<PngComplaint*>(png_get_error_ptr(png));
    std::strncpy(complaint->text, message, sizeof(complaint->text) - 1);
    png_longjmp(png, 1);
}

void png_ignore(png_structp, png_const_charp) {}

}  // namespace raykiln
