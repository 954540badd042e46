#include "image/bmp.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cstdlib>

#include "error.h"
#include "image/byte_reader.h"
#include "image/limits.h"

namespace raykiln {

namespace {

enum Compression : std::uint32_t { plain = 0, bit_fields = 3, alpha_bit_fields = 6 };

struct Header {
    std::uint32_t pixels_at = 0, size = 0;
    std::int64_t width = 0, height = 0;
    bool from_top = false;
    std::uint32_t bits = 0, compression = plain, colours = 0;
    std::array<std::uint32_t, 4> masks{};  // R, G, B, A

    bool mapped() const { return bits <= 8; }
};

[[noreturn]] void unsupported(const std::string& what) {
    throw ImageError("unsupported BMP image: " + what);
}

// The 12-byte header of OS/2 1.x: 16 bit numbers, no compression.
void read_core_header(ByteReader& in, Header& h) {
    h.width = in.u16();
    h.height = in.u16();
    in.skip(2);
    h.bits = in.u16();
}

void read_masks(ByteReader& in, Header& h) {
    if (h.compression == plain) {
        h.masks = h.bits == 16 ? std::array<std::uint32_t, 4>{0x7c00, 0x3e0, 0x1f, 0}
                               : std::array<std::uint32_t, 4>{0xff0000, 0xff00, 0xff, 0};
        return;
    }
    const bool has_alpha = h.compression == alpha_bit_fields || h.size >= 56;
    for (int c = 0; c < (has_alpha ? 4 : 3); ++c) {
        h.masks[static_cast<std::size_t>(c)] = in.u32();
    }
}

void read_info_header(ByteReader& in, Header& h) {
    h.width = in.i32();
    const std::int64_t height = in.i32();
    h.from_top = height < 0;
    h.height = std::abs(height);
    in.skip(2);
    h.bits = in.u16();
    h.compression = in.u32();
    in.skip(12);  // size of the pixels, resolution
    h.colours = in.u32();
    in.skip(4);
}

void check(const Header& h) {
    const std::array<std::uint32_t, 6> known{1, 4, 8, 16, 24, 32};
    if (std::ranges::find(known, h.bits) == known.end()) {
        unsupported("a pixel has 1, 4, 8, 16, 24 or 32 bits (found " +
                    std::to_string(h.bits) + ")");
    }
    const bool masked = h.compression == bit_fields || h.compression == alpha_bit_fields;
    if (h.compression != plain && !(masked && (h.bits == 16 || h.bits == 32))) {
        unsupported("its compression is not accepted (found type " +
                    std::to_string(h.compression) + ")");
    }
}

Header read_header(ByteReader& in) {
    Header h;
    in.skip(10);
    h.pixels_at = in.u32();
    const std::size_t begin = in.position();
    h.size = in.u32();
    if (h.size == 12) {
        read_core_header(in, h);
    } else if (h.size >= 40 && h.size <= 124) {
        read_info_header(in, h);
    } else {
        unsupported("its header has " + std::to_string(h.size) + " bytes");
    }
    check(h);
    read_masks(in, h);
    // The masks are inside the header of later versions and behind it in the first.
    in.seek(std::max(begin + h.size, in.position()));
    return h;
}

std::uint8_t masked_value(std::uint32_t pixel, std::uint32_t mask) {
    if (mask == 0) {
        return 0;
    }
    const std::uint64_t value = (pixel & mask) >> std::countr_zero(mask);
    const std::uint64_t largest = mask >> std::countr_zero(mask);
    return static_cast<std::uint8_t>((value * 255 + largest / 2) / largest);
}

class Decoder {
  public:
    explicit Decoder(std::span<const std::byte> file) :
        in_(file),
        header_(read_header(in_)),
        channels_(!header_.mapped() && header_.masks[3] ? 4 : 3) {
        check_image_size(header_.width, header_.height, channels_);
        check_plausible(static_cast<std::uint64_t>(header_.width * header_.height) *
                            static_cast<std::uint64_t>(channels_),
                        file.size());
        if (header_.mapped()) {
            read_palette();
        }
        in_.seek(header_.pixels_at);
    }

    Image decode() {
        Image image;
        image.width = static_cast<int>(header_.width);
        image.height = static_cast<int>(header_.height);
        image.channels = channels_;
        image.format = PixelFormat::u8;
        image.pixels = zeroed_pixels(image.size_bytes());
        const std::size_t row_bytes =
            (static_cast<std::size_t>(header_.width) * header_.bits + 31) / 32 * 4;
        for (int row = 0; row < image.height; ++row) {
            const int y = header_.from_top ? row : image.height - 1 - row;
            auto* out = reinterpret_cast<std::uint8_t*>(image.pixels.get()) +
                        std::size_t(y) * image.width * channels_;
            read_row(in_.bytes(row_bytes), out);
        }
        return image;
    }

  private:
    void read_palette() {
        const std::size_t most = std::size_t{1} << header_.bits;
        const std::size_t count = header_.colours ? header_.colours : most;
        for (std::size_t i = 0; i < std::min(count, most); ++i) {
            const std::uint32_t bgr = in_.number(3);
            in_.skip(header_.size == 12 ? 0 : 1);
            palette_.push_back({static_cast<std::uint8_t>(bgr >> 16),
                                static_cast<std::uint8_t>(bgr >> 8),
                                static_cast<std::uint8_t>(bgr)});
        }
    }

    void read_row(std::span<const std::byte> row, std::uint8_t* out) const {
        ByteReader in(row);
        for (std::int64_t x = 0; x < header_.width; ++x, out += channels_) {
            if (header_.mapped()) {
                std::ranges::copy(palette_colour(row, static_cast<std::size_t>(x)), out);
                continue;
            }
            const std::uint32_t pixel = in.number(static_cast<int>(header_.bits / 8));
            for (int c = 0; c < channels_; ++c) {
                out[c] = masked_value(pixel, header_.masks[static_cast<std::size_t>(c)]);
            }
        }
    }

    const std::array<std::uint8_t, 3>& palette_colour(std::span<const std::byte> row,
                                                      std::size_t x) const {
        const std::size_t bit = x * header_.bits;
        const auto byte = static_cast<std::uint32_t>(row[bit / 8]);
        const std::uint32_t index =
            (byte >> (8 - header_.bits - bit % 8)) & ((1u << header_.bits) - 1);
        if (index >= palette_.size()) {
            throw ImageError("the file is damaged: colour " + std::to_string(index) +
                             " is not in its palette");
        }
        return palette_[index];
    }

    ByteReader in_;
    Header header_;
    int channels_;
    std::vector<std::array<std::uint8_t, 3>> palette_;
};

}  // namespace

Image decode_bmp(std::span<const std::byte> file) {
    Image image = Decoder(file).decode();
    image.channel_names = {"R", "G", "B", "A"};
    image.channel_names.resize(static_cast<std::size_t>(image.channels));
    return image;
}

}  // namespace raykiln
