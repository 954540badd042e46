#include "bind.h"
#include "error.h"
#include "image/write_image.h"
#include "image_arrays.h"

namespace py = pybind11;

namespace raykiln {

namespace {

using FloatPlane = py::array_t<float, py::array::forcecast>;
template <typename T>
using Packed = py::array_t<T, py::array::c_style>;

py::array array_of(std::vector<unsigned char> bytes) {
    auto owner = std::make_unique<std::vector<unsigned char>>(std::move(bytes));
    const auto& held = *owner;
    return adopt(std::move(owner), py::dtype::of<std::uint8_t>(),
                 {static_cast<py::ssize_t>(held.size())}, held.data());
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
    bind_image_readers(m, {read_image, read_image, "raykiln._oiio"});
    m.def("encode_exr", &encode_exr_of, py::arg("channels"), py::arg("window"),
          py::arg("metadata"));
    m.def("encode_png", &encode_png_of<std::uint8_t>, py::arg("pixels").noconvert(),
          py::arg("metadata"));
    m.def("encode_png", &encode_png_of<std::uint16_t>, py::arg("pixels").noconvert(),
          py::arg("metadata"));
}

}  // namespace raykiln
