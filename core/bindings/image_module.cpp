#include "bind.h"

PYBIND11_MODULE(_image, m) {
    m.doc() = "Image files for raykiln; use it through the package `raykiln.image`.";
    raykiln::bind_errors(m);
    raykiln::bind_image(m);
}
