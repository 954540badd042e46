#include "bind.h"
#include "image/read_by_oiio.h"
#include "image_arrays.h"

PYBIND11_MODULE(_oiio, m) {
    m.doc() = "Image files that OpenImageIO reads; use it through `raykiln.image`.";
    raykiln::bind_errors(m);
    raykiln::bind_image_readers(m, {raykiln::read_by_oiio, raykiln::read_by_oiio});
}
