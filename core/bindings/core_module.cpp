#include "bind.h"

PYBIND11_MODULE(_core, m) {
    m.doc() = "The compiled core of raykiln; use it through the package `raykiln`.";
    m.attr("__version__") = RAYKILN_VERSION;
    raykiln::bind_errors(m);
    raykiln::bind_scene(m);
    raykiln::bind_render(m);
}
