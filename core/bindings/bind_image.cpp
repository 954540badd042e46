#include "bind.h"
namespace raykiln { void bind_image(pybind11::module_&) {} }
