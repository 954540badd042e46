#pragma once

#include <string>

namespace raykiln {

/// `message` without the file's name (not empty), which callers add in their own way.
std::string without_name(std::string message, const std::string& name);

/// The first line of a library's message, or of `fallback` if it said nothing.
std::string one_line(const std::string& message, const char* fallback);

/// Throws the ImageError of a file of this kind that cannot be decoded.
[[noreturn]] void fail_to_read(const char* title, const std::string& what);

/// Throws the ImageError of an image that cannot be encoded.
[[noreturn]] void fail_to_write(const char* kind, const std::string& what);

}  // namespace raykiln
