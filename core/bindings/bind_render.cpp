#include "bind.h"
namespace raykiln { void bind_render(pybind11::module_&) {} }
