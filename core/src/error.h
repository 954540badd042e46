#pragma once

#include <stdexcept>
#include <string>

namespace raykiln {

/// A scene, image or setting that cannot be used; `bindings/errors.cpp` maps it to
/// Python. `pointer` says where (a JSON pointer into the scene description, or empty).
struct SceneError : std::runtime_error {
    SceneError(const std::string& message, std::string where = {}) :
        std::runtime_error(message),
        pointer(std::move(where)) {}
    std::string pointer;
};

/// A setting of the render or of the process that cannot be used.
struct SettingsError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// An image file that cannot be read or written; the message says why.
struct ImageError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// A render that could not go on, or a film state that does not fit.
struct RenderError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

}  // namespace raykiln
