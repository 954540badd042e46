#include <pybind11/stl/filesystem.h>

#include "bind.h"
#include "error.h"
#include "image/read_image.h"
#include "image/write_image.h"

namespace py = pybind11;

namespace raykiln {

namespace {

using FloatPlane = py::array_t<float, py::array::forcecast>;
template <typename T>
using Packed = py::array_t<T, py::array::c_style>;

// Hand a heap object's memory to NumPy, which frees the object with the array.
template <typename Owner>
py::array adopt(std::unique_ptr<Owner> owner, const py::dtype& dtype,
                std::vector<py::ssize_t> shape, const void* data) {
    py::capsule capsule(owner.get(), [](void* p) { delete static_cast<Owner*>(p); });
    owner.release();
    return py::array(dtype, std::move(shape), data, capsule);
}

py::array array_of(Image image) {
    const py::dtype dtype =
        image.format == PixelFormat::u8    ? py::dtype::of<std::uint8_t>()
        : image.format == PixelFormat::u16 ? py::dtype::of<std::uint16_t>()
                                           : py::dtype::of<float>();
    auto owner = std::make_unique<Image>(std::move(image));
    const Image& held = *owner;
    return adopt(std::move(owner), dtype, {held.height, held.width, held.channels},
                 held.pixels.get());
}

py::array array_of(std::vector<unsigned char> bytes) {
    auto owner = std::make_unique<std::vector<unsigned char>>(std::move(bytes));
    const auto& held = *owner;
    return adopt(std::move(owner), py::dtype::of<std::uint8_t>(),
                 {static_cast<py::ssize_t>(held.size())}, held.data());
}

Image read_path(const std::filesystem::path& path, ChannelChoice choice) {
    py::gil_scoped_release unlocked;
    return read_image(path, choice);
}

Image read_buffer(const py::buffer& buffer, ChannelChoice choice) {
    Py_buffer view;
    if (PyObject_GetBuffer(buffer.ptr(), &view, PyBUF_SIMPLE) != 0) {
        throw py::error_already_set();
    }
    const std::unique_ptr<Py_buffer, decltype(&PyBuffer_Release)> held(&view,
                                                                       PyBuffer_Release);
    const std::span file(static_cast<const std::byte*>(view.buf),
                         static_cast<std::size_t>(view.len));
    py::gil_scoped_release unlocked;
    return read_image(file, choice);
}

py::dict layers_of(Image image) {
    py::dict result;
    py::dict metadata;
    for (const auto& [name, value] : image.metadata) {
        metadata[py::str(name)] = value;
    }
    const Window& w = image.window;
    result["names"] = image.channel_names;
    result["window"] = py::make_tuple(w.x, w.y, w.full_width, w.full_height);
    result["metadata"] = metadata;
    result["pixels"] = array_of(std::move(image));
    return result;
}

ExrChannel channel_of(const std::string& name, const FloatPlane& plane, bool half) {
    const auto step = static_cast<py::ssize_t>(sizeof(float));
    if (plane.strides(0) % step != 0 || plane.strides(1) % step != 0) {
        throw ImageError("channel " + name +
                         " has strides that are no multiple of a float");
    }
    return {name, plane.data(), plane.strides(1) / step, plane.strides(0) / step, half};
}

// `channels`: (name, float32 plane of shape (h, w), stored as half) each.
py::array encode_exr_of(
    const std::vector<std::tuple<std::string, FloatPlane, bool>>& channels,
    const std::tuple<int, int, int, int>& window, const Metadata& metadata) {
    std::vector<ExrChannel> views;
    for (const auto& [name, plane, half] : channels) {
        const FloatPlane& first = std::get<1>(channels.front());
        if (plane.ndim() != 2 || plane.shape(0) != first.shape(0) ||
            plane.shape(1) != first.shape(1)) {
            throw ImageError("channel " + name + " does not have the shape of the first");
        }
        views.push_back(channel_of(name, plane, half));
    }
    if (views.empty()) {
        throw ImageError("an OpenEXR image needs at least one channel");
    }
    const auto [x, y, full_width, full_height] = window;
    const FloatPlane& first = std::get<1>(channels.front());
    const int height = static_cast<int>(first.shape(0));
    const int width = static_cast<int>(first.shape(1));
    std::vector<unsigned char> bytes;
    {
        py::gil_scoped_release unlocked;
        bytes =
            encode_exr(width, height, views, {x, y, full_width, full_height}, metadata);
    }
    return array_of(std::move(bytes));
}

template <typename T>
py::array encode_png_of(const Packed<T>& pixels, const Metadata& metadata) {
    if (pixels.ndim() != 3) {
        throw ImageError("PNG pixels need the shape (height, width, channels)");
    }
    const PngPixels view{
        static_cast<int>(pixels.shape(1)), static_cast<int>(pixels.shape(0)),
        static_cast<int>(pixels.shape(2)),
        sizeof(T) == 1 ? PixelFormat::u8 : PixelFormat::u16, pixels.data()};
    std::vector<unsigned char> bytes;
    {
        py::gil_scoped_release unlocked;
        bytes = encode_png(view, metadata);
    }
    return array_of(std::move(bytes));
}

}  // namespace

void bind_image(py::module_& m) {
    m.def(
        "read_image",
        [](const py::buffer& file) {
            return array_of(read_buffer(file, ChannelChoice::colour));
        },
        py::arg("source"));
    m.def(
        "read_image",
        [](const std::filesystem::path& path) {
            return array_of(read_path(path, ChannelChoice::colour));
        },
        py::arg("source"));
    m.def(
        "read_channels",
        [](const py::buffer& file) {
            return layers_of(read_buffer(file, ChannelChoice::all));
        },
        py::arg("source"));
    m.def(
        "read_channels",
        [](const std::filesystem::path& path) {
            return layers_of(read_path(path, ChannelChoice::all));
        },
        py::arg("source"));
    m.def("encode_exr", &encode_exr_of, py::arg("channels"), py::arg("window"),
          py::arg("metadata"));
    m.def("encode_png", &encode_png_of<std::uint8_t>, py::arg("pixels").noconvert(),
          py::arg("metadata"));
    m.def("encode_png", &encode_png_of<std::uint16_t>, py::arg("pixels").noconvert(),
          py::arg("metadata"));
}

}  // namespace raykiln
