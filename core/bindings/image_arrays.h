#pragma once

#include <pybind11/numpy.h>

#include <filesystem>
#include <memory>
#include <span>
#include <vector>

#include "image/image.h"
#include "image/read_image.h"

namespace raykiln {

/// Hand a heap object's memory to NumPy, which frees the object with the array.
template <typename Owner>
pybind11::array adopt(std::unique_ptr<Owner> owner, const pybind11::dtype& dtype,
                      std::vector<pybind11::ssize_t> shape, const void* data) {
    pybind11::capsule capsule(owner.get(),
                              [](void* p) { delete static_cast<Owner*>(p); });
    owner.release();
    return pybind11::array(dtype, std::move(shape), data, capsule);
}

/// The ways to read an image that a module has.
struct ImageReaders {
    Image (*from_file)(const std::filesystem::path& path, ChannelChoice choice);
    Image (*from_memory)(std::span<const std::byte> file, ChannelChoice choice);
    /// The module for the kinds without a decoder here, imported when one is met.
    const char* module_for_others = nullptr;
};

/// `read_image` and `read_channels`, of a path or of bytes.
void bind_image_readers(pybind11::module_& m, const ImageReaders& readers);

}  // namespace raykiln
