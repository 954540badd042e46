#include <zlib.h>

#include <algorithm>
#include <bit>
#include <csetjmp>
#include <new>

#include "error.h"
#include "image/limits.h"
#include "image/message.h"
#include "image/png_seam.h"
#include "image/write_image.h"

namespace raykiln {

namespace {

using Bytes = std::vector<unsigned char>;

// libpng calls this from C: an exception may not pass through it.
void put(png_structp png, png_bytep from, std::size_t count) {
    auto* bytes = static_cast<Bytes*>(png_get_io_ptr(png));
    bool full = false;
    try {
        bytes->insert(bytes->end(), from, from + count);
    } catch (const std::bad_alloc&) {
        full = true;
    }
    if (full) {
        png_error(png, "not enough memory");
    }
}

class Writer {
  public:
    Writer() {
        png_ = png_create_write_struct(PNG_LIBPNG_VER_STRING, &complaint_, png_fail,
                                       png_ignore);
        info_ = png_ != nullptr ? png_create_info_struct(png_) : nullptr;
        if (info_ == nullptr) {
            png_destroy_write_struct(&png_, nullptr);
            throw std::bad_alloc();
        }
    }
    ~Writer() { png_destroy_write_struct(&png_, &info_); }
    Writer(const Writer&) = delete;
    Writer& operator=(const Writer&) = delete;

    Bytes encode(const PngPixels& pixels, std::vector<png_text>& texts) {
        if (!write(pixels, texts.data(), static_cast<int>(texts.size()))) {
            fail_to_write("png", one_line(complaint_.text, "its writer failed"));
        }
        return std::move(bytes_);
    }

  private:
    // No objects with destructors here: see png_fail.
    bool write(const PngPixels& pixels, png_textp texts, int text_count) {
        if (setjmp(png_jmpbuf(png_)) != 0) {
            return false;
        }
        constexpr int types[] = {PNG_COLOR_TYPE_GRAY, PNG_COLOR_TYPE_GRAY_ALPHA,
                                 PNG_COLOR_TYPE_RGB, PNG_COLOR_TYPE_RGB_ALPHA};
        const std::size_t value = value_bytes(pixels.format);
        png_set_write_fn(png_, &bytes_, put, nullptr);
        png_set_IHDR(png_, info_, static_cast<png_uint_32>(pixels.width),
                     static_cast<png_uint_32>(pixels.height), static_cast<int>(8 * value),
                     types[pixels.channels - 1], PNG_INTERLACE_NONE,
                     PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
        png_set_sRGB_gAMA_and_cHRM(png_, info_, PNG_sRGB_INTENT_ABSOLUTE);
        // Pictures compress hardly better by libpng's own choice, but slower.
        png_set_compression_strategy(png_, Z_DEFAULT_STRATEGY);
        png_set_text(png_, info_, texts, text_count);
        png_write_info(png_, info_);
        if (std::endian::native == std::endian::little) {
            png_set_swap(png_);
        }
        const std::size_t stride = value * static_cast<std::size_t>(pixels.channels) *
                                   static_cast<std::size_t>(pixels.width);
        const auto* row = static_cast<png_const_bytep>(pixels.values);
        for (int y = 0; y < pixels.height; ++y, row += stride) {
            png_write_row(png_, row);
        }
        png_write_end(png_, nullptr);
        return true;
    }

    Bytes bytes_;
    PngComplaint complaint_;
    png_structp png_ = nullptr;
    png_infop info_ = nullptr;
};

bool is_ascii(const std::string& text) {
    return std::ranges::all_of(text, [](char c) { return (c & 0x80) == 0; });
}

// Chunks of text, which is Latin-1 in the old kind and UTF-8 in the new one.
std::vector<png_text> texts_of(const Metadata& metadata) {
    std::vector<png_text> texts;
    for (const auto& [name, value] : metadata) {
        if (const auto* text = std::get_if<std::string>(&value)) {
            png_text chunk{};
            chunk.compression =
                is_ascii(*text) ? PNG_TEXT_COMPRESSION_NONE : PNG_ITXT_COMPRESSION_NONE;
            chunk.key = const_cast<png_charp>(name.c_str());
            chunk.text = const_cast<png_charp>(text->c_str());
            texts.push_back(chunk);
        }
    }
    return texts;
}

}  // namespace

std::vector<unsigned char> encode_png(const PngPixels& pixels, const Metadata& metadata) {
    check_size_to_write("png", pixels.width, pixels.height,
                        static_cast<std::size_t>(std::max(pixels.channels, 0)));
    if (pixels.channels > 4 || pixels.format == PixelFormat::f32) {
        fail_to_write("png", "it holds 1 to 4 channels of 8 or 16 bits");
    }
    try {
        auto texts = texts_of(metadata);
        return Writer().encode(pixels, texts);
    } catch (const std::bad_alloc&) {
        fail_to_write("png", "not enough memory");
    }
}

}  // namespace raykiln
