#include "image/targa.h"

#include <algorithm>
#include <array>

#include "error.h"
#include "image/byte_reader.h"
#include "image/limits.h"

namespace raykiln {

namespace {

using Pixel = std::array<std::uint8_t, 4>;  // R, G, B, A or grey, A

struct Header {
    std::uint32_t id_length, map_type, image_type, map_first, map_length, map_bits;
    std::uint32_t width, height, bits, descriptor;

    bool mapped() const { return (image_type & 7) == 1; }
    bool grey() const { return (image_type & 7) == 3; }
    bool run_lengths() const { return image_type >= 9; }
};

Header read_header(ByteReader& in) {
    Header h{};
    h.id_length = in.u8();
    h.map_type = in.u8();
    h.image_type = in.u8();
    h.map_first = in.u16();
    h.map_length = in.u16();
    h.map_bits = in.u8();
    in.skip(4);  // the origin on a screen
    h.width = in.u16();
    h.height = in.u16();
    h.bits = in.u8();
    h.descriptor = in.u8();
    return h;
}

[[noreturn]] void unsupported(const char* what, std::uint32_t found) {
    throw ImageError(std::string("unsupported Targa image: ") + what + " (found " +
                     std::to_string(found) + ")");
}

// Channels of a stored colour of that many bits.
int colour_channels_of(std::uint32_t bits) {
    switch (bits) {
        case 15:
        case 16:
        case 24:
            return 3;
        case 32:
            return 4;
        default:
            unsupported("colours have 15, 16, 24 or 32 bits", bits);
    }
}

int channels_of(const Header& h) {
    if (h.mapped()) {
        if (h.map_type != 1 || (h.bits != 8 && h.bits != 16)) {
            unsupported("colour-map indices have 8 or 16 bits", h.bits);
        }
        return colour_channels_of(h.map_bits);
    }
    if (h.grey()) {
        if (h.bits != 8 && h.bits != 16) {
            unsupported("grey has 8 or 16 bits", h.bits);
        }
        return static_cast<int>(h.bits / 8);
    }
    return colour_channels_of(h.bits);
}

std::uint8_t from_5_bits(std::uint32_t value) {
    return static_cast<std::uint8_t>(((value & 31) * 255 + 15) / 31);
}

Pixel colour_of(std::uint32_t v, std::uint32_t bits) {
    if (bits <= 16) {
        return {from_5_bits(v >> 10), from_5_bits(v >> 5), from_5_bits(v), 255};
    }
    const auto byte = [v](int shift) { return static_cast<std::uint8_t>(v >> shift); };
    return {byte(16), byte(8), byte(0), byte(24)};
}

int bytes_of(std::uint32_t bits) {
    return static_cast<int>((bits + 7) / 8);
}

class Decoder {
  public:
    explicit Decoder(std::span<const std::byte> file) :
        in_(file),
        header_(read_header(in_)),
        channels_(channels_of(header_)) {
        check_image_size(header_.width, header_.height, channels_);
        check_plausible(std::uint64_t{header_.width} * header_.height * channels_,
                        file.size());
        in_.skip(header_.id_length);
        read_map();
    }

    Image decode() {
        Image image;
        image.width = static_cast<int>(header_.width);
        image.height = static_cast<int>(header_.height);
        image.channels = channels_;
        image.format = PixelFormat::u8;
        image.pixels = zeroed_pixels(image.size_bytes());
        const bool from_top = header_.descriptor & 0x20;
        for (int row = 0; row < image.height; ++row) {
            read_row(image, from_top ? row : image.height - 1 - row);
        }
        return image;
    }

  private:
    void read_map() {
        if (!header_.mapped()) {
            // A colour map may be there without being used.
            in_.skip(std::size_t{header_.map_length} * bytes_of(header_.map_bits));
            return;
        }
        for (std::uint32_t i = 0; i < header_.map_length; ++i) {
            map_.push_back(
                colour_of(in_.number(bytes_of(header_.map_bits)), header_.map_bits));
        }
    }

    void read_row(Image& image, int y) {
        auto* row = reinterpret_cast<std::uint8_t*>(image.pixels.get()) +
                    std::size_t(y) * image.width * channels_;
        const bool from_right = header_.descriptor & 0x10;
        for (int i = 0; i < image.width; ++i) {
            const Pixel pixel = next_pixel();
            const int x = from_right ? image.width - 1 - i : i;
            std::copy_n(pixel.begin(), channels_, row + std::size_t(x) * channels_);
        }
    }

    // Packets of runs may go on from one row to the next, so their state lives here.
    Pixel next_pixel() {
        if (!header_.run_lengths()) {
            return read_pixel();
        }
        if (left_ == 0) {
            const std::uint32_t packet = in_.u8();
            repeats_ = packet & 0x80;
            left_ = (packet & 0x7f) + 1;
            if (repeats_) {
                repeated_ = read_pixel();
            }
        }
        --left_;
        return repeats_ ? repeated_ : read_pixel();
    }

    Pixel read_pixel() {
        const std::uint32_t value = in_.number(bytes_of(header_.bits));
        if (header_.grey()) {
            return {static_cast<std::uint8_t>(value),
                    static_cast<std::uint8_t>(value >> 8)};
        }
        if (!header_.mapped()) {
            return colour_of(value, header_.bits);
        }
        const std::uint32_t index = value - header_.map_first;
        if (value < header_.map_first || index >= map_.size()) {
            throw ImageError("the file is damaged: colour " + std::to_string(value) +
                             " is not in its colour map");
        }
        return map_[index];
    }

    ByteReader in_;
    Header header_;
    int channels_;
    std::vector<Pixel> map_;
    Pixel repeated_{};
    std::uint32_t left_ = 0;
    bool repeats_ = false;
};

}  // namespace

Image decode_targa(std::span<const std::byte> file) {
    Image image = Decoder(file).decode();
    if (image.channels <= 2) {
        image.channel_names = {"Y", "A"};
    } else {
        image.channel_names = {"R", "G", "B", "A"};
    }
    image.channel_names.resize(static_cast<std::size_t>(image.channels));
    return image;
}

}  // namespace raykiln
