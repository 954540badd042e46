#pragma once

#include <cstddef>
#include <optional>
#include <span>

#include "image/image.h"

namespace raykiln {

/// A kind of image file that may be read.
struct FileKind {
    const char* reader;  ///< name of its OpenImageIO reader, where it has no `decode`
    const char* title;   ///< its name in messages
    Image (*decode)(std::span<const std::byte> file) = nullptr;  ///< our own decoder
};

/// Leading bytes that `file_kind` needs to see (fewer only if the file is shorter).
inline constexpr std::size_t magic_bytes = 18;

/// The kind that the first bytes of a file announce, whatever the file is called; empty
/// if they announce none of the accepted kinds, so that no other reader ever sees the
/// file.
std::optional<FileKind> file_kind(std::span<const std::byte> head);

/// The accepted kinds as one phrase for error messages.
const char* accepted_file_kinds();

}  // namespace raykiln
