#include <pybind11/stl/filesystem.h>

#include "bind.h"
#include "image/file_kind.h"
#include "image_arrays.h"

namespace py = pybind11;

namespace raykiln {

namespace {

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

// Calls `read` with the bytes of a Python object, without holding the interpreter's lock.
template <typename Read>
auto with_bytes_of(const py::buffer& buffer, Read read) {
    Py_buffer view;
    if (PyObject_GetBuffer(buffer.ptr(), &view, PyBUF_SIMPLE) != 0) {
        throw py::error_already_set();
    }
    const std::unique_ptr<Py_buffer, decltype(&PyBuffer_Release)> held(&view,
                                                                       PyBuffer_Release);
    const std::span file(static_cast<const std::byte*>(view.buf),
                         static_cast<std::size_t>(view.len));
    py::gil_scoped_release unlocked;
    return read(file);
}

// Text of a file, which may be any bytes.
py::object text_of(const std::string& text) {
    const auto size = static_cast<py::ssize_t>(text.size());
    PyObject* decoded = PyUnicode_DecodeUTF8(text.data(), size, "backslashreplace");
    if (decoded == nullptr) {
        throw py::error_already_set();
    }
    return py::reinterpret_steal<py::object>(decoded);
}

py::dict layers_of(Image image) {
    py::dict result;
    py::dict metadata;
    for (const auto& [name, value] : image.metadata) {
        const auto* text = std::get_if<std::string>(&value);
        metadata[text_of(name)] = text ? text_of(*text) : py::cast(value);
    }
    py::list names;
    for (const std::string& name : image.channel_names) {
        names.append(text_of(name));
    }
    const Window& w = image.window;
    result["names"] = names;
    result["window"] = py::make_tuple(w.x, w.y, w.full_width, w.full_height);
    result["metadata"] = metadata;
    result["pixels"] = array_of(std::move(image));
    return result;
}

}  // namespace

void bind_image_readers(py::module_& m, const ImageReaders& readers) {
    // The result of the module that reads this kind of file, or none if that is ours.
    const auto from_elsewhere = [=](const char* name, const FileKind& kind,
                                    const py::object& source) -> py::object {
        if (kind.decode != nullptr || readers.module_for_others == nullptr) {
            return {};
        }
        return py::module_::import(readers.module_for_others).attr(name)(source);
    };
    const auto define = [&](const char* name, ChannelChoice choice, auto result_of) {
        m.def(
            name,
            [=](const py::buffer& source) -> py::object {
                const auto kind =
                    with_bytes_of(source, [](auto file) { return kind_of_file(file); });
                if (auto result = from_elsewhere(name, kind, source)) {
                    return result;
                }
                return result_of(with_bytes_of(source, [&](auto file) {
                    return readers.from_memory(file, choice);
                }));
            },
            py::arg("source"));
        m.def(
            name,
            [=](const std::filesystem::path& source) -> py::object {
                if (auto result =
                        from_elsewhere(name, kind_of_file(source), py::cast(source))) {
                    return result;
                }
                std::optional<Image> image;
                {
                    py::gil_scoped_release unlocked;
                    image = readers.from_file(source, choice);
                }
                return result_of(std::move(*image));
            },
            py::arg("source"));
    };
    define("read_image", ChannelChoice::colour,
           [](Image image) { return array_of(std::move(image)); });
    define("read_channels", ChannelChoice::all,
           [](Image image) { return layers_of(std::move(image)); });
}

}  // namespace raykiln
