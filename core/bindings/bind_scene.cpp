#include "bind.h"
namespace raykiln { void bind_scene(pybind11::module_&) {} }
