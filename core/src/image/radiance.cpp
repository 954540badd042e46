#include "image/radiance.h"

#include <array>
#include <charconv>
#include <cmath>
#include <new>
#include <string>
#include <string_view>

#include "error.h"
#include "image/byte_reader.h"
#include "image/limits.h"
#include "image/message.h"

namespace raykiln {

namespace {

constexpr const char* title = "Radiance HDR";

using Rgbe = std::array<std::uint8_t, 4>;

std::string_view line_of(ByteReader& in) {
    constexpr std::size_t longest = 4096;
    const auto* begin = in.bytes(0).data();
    std::size_t size = 0;
    while (in.u8() != '\n') {
        if (++size > longest) {
            fail_to_read(title, "a line of its header does not end");
        }
    }
    std::string_view line(reinterpret_cast<const char*>(begin), size);
    return line.ends_with('\r') ? line.substr(0, size - 1) : line;
}

// An axis with its sign, as in "-Y 512", and the space before it.
std::int64_t axis_of(std::string_view& text) {
    const std::size_t at = text.find_first_not_of(' ');
    text.remove_prefix(at == std::string_view::npos ? text.size() : at);
    std::int64_t size = 0;
    if (text.size() > 3 && (text[0] == '-' || text[0] == '+') &&
        (text[1] == 'X' || text[1] == 'Y') && text[2] == ' ') {
        const auto [end, error] =
            std::from_chars(text.data() + 3, text.data() + text.size(), size);
        text.remove_prefix(static_cast<std::size_t>(end - text.data()));
        if (error == std::errc()) {
            return size;
        }
    }
    fail_to_read(title, "its line of sizes cannot be read");
}

struct Size {
    std::int64_t width, height;
};

Size read_header(ByteReader& in) {
    constexpr int most_lines = 1000;
    line_of(in);  // #?RADIANCE, or the name of another program
    for (int i = 0; i < most_lines; ++i) {
        const std::string_view line = line_of(in);
        if (line.starts_with("FORMAT=") && line != "FORMAT=32-bit_rle_rgbe") {
            fail_to_read(title, "only FORMAT=32-bit_rle_rgbe is accepted");
        }
        if (line.empty()) {
            std::string_view sizes = line_of(in);
            const std::int64_t height = axis_of(sizes);
            return {axis_of(sizes), height};
        }
    }
    fail_to_read(title, "its header does not end");
}

Rgbe pixel_of(ByteReader& in) {
    const auto bytes = in.bytes(4);
    Rgbe pixel;
    for (std::size_t i = 0; i < 4; ++i) {
        pixel[i] = static_cast<std::uint8_t>(bytes[i]);
    }
    return pixel;
}

// One of the four planes of a row: runs and literal stretches.
void read_plane(ByteReader& in, std::vector<Rgbe>& row, std::size_t channel) {
    for (std::size_t x = 0; x < row.size();) {
        const std::size_t code = in.u8();
        const bool is_run = code > 128;
        const std::size_t count = is_run ? code - 128 : code;
        if (count == 0 || count > row.size() - x) {
            fail_to_read(title, "a run does not fit its row");
        }
        auto value = static_cast<std::uint8_t>(is_run ? in.u8() : 0);
        for (const std::size_t end = x + count; x < end; ++x) {
            row[x][channel] = is_run ? value : static_cast<std::uint8_t>(in.u8());
        }
    }
}

// Pixels one after the other; 1 1 1 n stands for n more of the last one, and such marks
// in a row count like digits.
void read_old(ByteReader& in, Rgbe first, std::vector<Rgbe>& row) {
    Rgbe pixel = first, last{};
    int shift = 0;
    for (std::size_t x = 0; x < row.size();) {
        if (pixel[0] == 1 && pixel[1] == 1 && pixel[2] == 1) {
            const std::size_t count =
                shift > 16 ? row.size() + 1 : std::size_t{pixel[3]} << shift;
            if (x == 0 || count > row.size() - x) {
                fail_to_read(title, "a run does not fit its row");
            }
            for (const std::size_t end = x + count; x < end; ++x) {
                row[x] = last;
            }
            shift += 8;
        } else {
            row[x++] = last = pixel;
            shift = 0;
        }
        if (x < row.size()) {
            pixel = pixel_of(in);
        }
    }
}

void read_row(ByteReader& in, std::vector<Rgbe>& row) {
    constexpr std::size_t narrowest = 8, widest = 0x7fff;
    const Rgbe first = pixel_of(in);
    const bool is_new = first[0] == 2 && first[1] == 2 && first[2] < 128 &&
                        row.size() >= narrowest && row.size() <= widest;
    if (!is_new) {
        read_old(in, first, row);
        return;
    }
    if ((std::size_t{first[2]} << 8 | first[3]) != row.size()) {
        fail_to_read(title, "a row has another width than the image");
    }
    for (std::size_t channel = 0; channel < 4; ++channel) {
        read_plane(in, row, channel);
    }
}

float* put_row(const std::vector<Rgbe>& row, float* to) {
    for (const Rgbe& pixel : row) {
        // Bits 8 to 1 behind the point, times 2 to the exponent less 128.
        const float scale = pixel[3] == 0 ? 0.0f : std::ldexp(1.0f, pixel[3] - 136);
        for (std::size_t c = 0; c < 3; ++c) {
            *to++ = scale * static_cast<float>(pixel[c]);
        }
    }
    return to;
}

}  // namespace

Image decode_radiance(std::span<const std::byte> file) {
    try {
        ByteReader in(file);
        const Size size = read_header(in);
        check_image_size(size.width, size.height, 3 * sizeof(float));
        Image image;
        image.width = static_cast<int>(size.width);
        image.height = static_cast<int>(size.height);
        image.channels = 3;
        image.channel_names = {"R", "G", "B"};
        image.window = {0, 0, image.width, image.height};
        check_plausible(image.size_bytes(), file.size());
        image.pixels = zeroed_pixels(image.size_bytes());
        std::vector<Rgbe> row(static_cast<std::size_t>(image.width));
        auto* to = reinterpret_cast<float*>(image.pixels.get());
        for (int y = 0; y < image.height; ++y) {
            read_row(in, row);
            to = put_row(row, to);
        }
        return image;
    } catch (const std::bad_alloc&) {
        fail_to_read(title, "not enough memory to decode it");
    }
}

}  // namespace raykiln
