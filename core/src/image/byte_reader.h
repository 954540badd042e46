#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "error.h"

namespace raykiln {

/// Reads little-endian numbers from a file in memory; a read past its end throws
/// ImageError.
class ByteReader {
  public:
    explicit ByteReader(std::span<const std::byte> file) : file_(file) {}

    std::span<const std::byte> bytes(std::size_t count) {
        if (count > file_.size() - at_) {
            throw ImageError("the file is damaged: it ends too early");
        }
        at_ += count;
        return file_.subspan(at_ - count, count);
    }
    std::uint32_t u8() { return number(1); }
    std::uint32_t u16() { return number(2); }
    std::uint32_t u32() { return number(4); }
    std::int32_t i32() { return static_cast<std::int32_t>(number(4)); }

    void skip(std::size_t count) { bytes(count); }
    void seek(std::size_t position) {
        at_ = 0;
        bytes(position);
    }
    std::size_t position() const { return at_; }

    /// A number of `count` bytes (1 to 4), least significant first.
    std::uint32_t number(int count) {
        std::uint32_t value = 0;
        int shift = 0;
        for (const std::byte b : bytes(static_cast<std::size_t>(count))) {
            value |= static_cast<std::uint32_t>(b) << shift;
            shift += 8;
        }
        return value;
    }

  private:
    std::span<const std::byte> file_;
    std::size_t at_ = 0;
};

}  // namespace raykiln
