#include "image/file_kind.h"

#include <array>
#include <string_view>

#include "image/bmp.h"
#include "image/exr.h"
#include "image/png.h"
#include "image/radiance.h"
#include "image/targa.h"

namespace raykiln {

namespace {

using namespace std::string_view_literals;

// For files without layers and metadata.
template <Image decode(std::span<const std::byte>)>
Image whole(std::span<const std::byte> file, ChannelChoice) {
    return decode(file);
}

struct Magic {
    std::size_t offset;
    std::string_view bytes;
    FileKind kind;
};

const std::array magics{
    Magic{0, "\x76\x2f\x31\x01"sv, {"OpenEXR", read_exr, nullptr, read_exr}},
    Magic{0, "\x89PNG\r\n\x1a\n"sv, {"PNG", read_png}},
    Magic{0, "\xff\xd8\xff"sv, {"JPEG", nullptr, "jpeg"}},
    Magic{0, "#?"sv, {"Radiance HDR", whole<decode_radiance>}},
    Magic{0, "II*\0"sv, {"TIFF", nullptr, "tiff"}},
    Magic{0, "MM\0*"sv, {"TIFF", nullptr, "tiff"}},
    Magic{0, "II+\0"sv, {"BigTIFF", nullptr, "tiff"}},
    Magic{0, "MM\0+"sv, {"BigTIFF", nullptr, "tiff"}},
    Magic{8, "WEBP"sv, {"WebP", nullptr, "webp"}},
    Magic{0, "BM"sv, {"BMP", whole<decode_bmp>}},
};

bool starts_with(std::string_view head, const Magic& magic) {
    return head.size() >= magic.offset &&
           head.substr(magic.offset).starts_with(magic.bytes);
}

// Targa has no magic bytes: its 18-byte header must make sense as a whole.
bool looks_like_targa(std::string_view head) {
    if (head.size() < 18) {
        return false;
    }
    const auto at = [&](int i) { return static_cast<unsigned char>(head[i]); };
    const int map_type = at(1), image_type = at(2), map_bits = at(7), bits = at(16);
    const bool mapped = image_type == 1 || image_type == 9;
    const bool known_type = mapped || image_type == 2 || image_type == 3 ||
                            image_type == 10 || image_type == 11;
    const bool known_bits =
        bits == 8 || bits == 15 || bits == 16 || bits == 24 || bits == 32;
    const bool known_map = map_type == 0 ? !mapped : map_type == 1 && map_bits >= 15;
    const bool has_pixels = (at(12) | at(13)) != 0 && (at(14) | at(15)) != 0;
    return known_type && known_bits && known_map && has_pixels;
}

}  // namespace

std::optional<FileKind> file_kind(std::span<const std::byte> head) {
    const std::string_view text{reinterpret_cast<const char*>(head.data()), head.size()};
    for (const Magic& magic : magics) {
        if (starts_with(text, magic)) {
            return magic.kind;
        }
    }
    if (looks_like_targa(text)) {
        return FileKind{"Targa", whole<decode_targa>};
    }
    return std::nullopt;
}

const char* accepted_file_kinds() {
    return "OpenEXR, PNG, JPEG, Radiance HDR, TIFF, WebP, Targa, BMP";
}

}  // namespace raykiln
