// The only place where C++ exceptions become Python ones.
#include "bind.h"
#include "error.h"

namespace py = pybind11;

namespace raykiln {

static void set_python_error(const char* name, const std::string& message,
                             const std::string& pointer = {}) {
    py::object type = py::module_::import("raykiln.errors").attr(name);
    py::dict details;
    if (!pointer.empty()) {
        details["pointer"] = pointer;
    }
    py::object error = type(message, **details);
    PyErr_SetObject(type.ptr(), error.ptr());
}

void bind_errors(py::module_&) {
    py::register_exception_translator([](std::exception_ptr p) {
        try {
            std::rethrow_exception(p);
        } catch (const SceneError& e) {
            set_python_error("SceneError", e.what(), e.pointer);
        } catch (const SettingsError& e) {
            set_python_error("SettingsError", e.what());
        } catch (const ImageError& e) {
            set_python_error("ImageError", e.what());
        } catch (const RenderError& e) {
            set_python_error("RenderError", e.what());
        }
    });
}

}  // namespace raykiln
