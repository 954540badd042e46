#include "image/read_image.h"

#include <algorithm>
#include <fstream>
#include <string>

#include "error.h"
#include "image/file_kind.h"
#include "image/limits.h"
#include "image/message.h"

namespace raykiln {

namespace {

// The first `count` bytes of a regular file, or all of them if it is shorter.
std::vector<std::byte> bytes_of(const std::filesystem::path& path, std::size_t count) {
    std::error_code error;
    const auto status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) {
        throw ImageError("no such file");
    }
    if (!std::filesystem::is_regular_file(status)) {
        throw ImageError("not a regular file");
    }
    std::ifstream file(path, std::ios::binary);
    if (!file) {
        throw ImageError("the file cannot be opened");
    }
    std::vector<std::byte> bytes(count);
    file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(count));
    bytes.resize(static_cast<std::size_t>(file.gcount()));
    return bytes;
}

FileKind kind_of(std::span<const std::byte> head) {
    if (head.empty()) {
        throw ImageError(std::string("the file is empty; accepted: ") +
                         accepted_file_kinds());
    }
    const auto kind = file_kind(head);
    if (!kind) {
        throw ImageError(std::string("not an image of an accepted kind; accepted: ") +
                         accepted_file_kinds());
    }
    return *kind;
}

FileKind kind_decoded_here(const FileKind& kind) {
    if (kind.decode == nullptr) {
        throw ImageError(std::string("files of the kind ") + kind.title +
                         " are left to OpenImageIO");
    }
    return kind;
}

}  // namespace

FileKind kind_of_file(const std::filesystem::path& path) {
    return kind_of(bytes_of(path, magic_bytes));
}

FileKind kind_of_file(std::span<const std::byte> file) {
    return kind_of(file.first(std::min(file.size(), magic_bytes)));
}

Image read_image(const std::filesystem::path& path, ChannelChoice choice) {
    const FileKind kind = kind_decoded_here(kind_of_file(path));
    if (kind.decode_file != nullptr) {
        return kind.decode_file(path, choice);
    }
    const std::size_t size = std::filesystem::file_size(path);
    if (size > static_cast<std::size_t>(max_image_bytes)) {
        fail_to_read(kind.title,
                     "a file of " + std::to_string(size) + " bytes is too large");
    }
    return kind.decode(bytes_of(path, size), choice);
}

Image read_image(std::span<const std::byte> file, ChannelChoice choice) {
    return kind_decoded_here(kind_of_file(file)).decode(file, choice);
}

}  // namespace raykiln
