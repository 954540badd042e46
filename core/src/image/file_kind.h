#pragma once

#include <cstddef>
#include <filesystem>
#include <optional>
#include <span>

#include "image/image.h"
#include "image/read_image.h"

namespace raykiln {

/// A kind of image file that may be read.
struct FileKind {
    const char* title;  ///< its name in messages
    /// Its decoder, but for those that are left to OpenImageIO.
    Image (*decode)(std::span<const std::byte> file, ChannelChoice choice) = nullptr;
    const char* oiio_reader = nullptr;  ///< the name of OpenImageIO's reader for it
    /// A decoder that does not need the whole file in memory.
    Image (*decode_file)(const std::filesystem::path& path,
                         ChannelChoice choice) = nullptr;
};

/// Leading bytes that `file_kind` needs to see (fewer only if the file is shorter).
inline constexpr std::size_t magic_bytes = 18;

/// The kind that the first bytes of a file announce, whatever the file is called; empty
/// if they announce none of the accepted kinds, so that no other reader ever sees the
/// file.
std::optional<FileKind> file_kind(std::span<const std::byte> head);

/// The kind of a file, by its first bytes.  Throws ImageError if it is none that is
/// accepted, or no file that can be read.
FileKind kind_of_file(const std::filesystem::path& path);
FileKind kind_of_file(std::span<const std::byte> file);

/// The accepted kinds as one phrase for error messages.
const char* accepted_file_kinds();

}  // namespace raykiln
