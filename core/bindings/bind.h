#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

namespace raykiln {

// One function a category; each adds its classes and functions to the module.
void bind_errors(pybind11::module_& m);
void bind_image(pybind11::module_& m);
void bind_scene(pybind11::module_& m);
void bind_render(pybind11::module_& m);

}  // namespace raykiln
