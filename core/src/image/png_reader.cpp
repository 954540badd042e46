#include <bit>
#include <csetjmp>
#include <cstring>
#include <new>
#include <vector>

#include "error.h"
#include "image/limits.h"
#include "image/message.h"
#include "image/png.h"
#include "image/png_seam.h"

namespace raykiln {

namespace {

constexpr const char* title = "PNG";

struct Source {
    std::span<const std::byte> file;
    std::size_t at = 0;
};

void take(png_structp png, png_bytep to, std::size_t count) {
    auto* source = static_cast<Source*>(png_get_io_ptr(png));
    if (count > source->file.size() - source->at) {
        png_error(png, "the file ends too early");
    }
    std::memcpy(to, source->file.data() + source->at, count);
    source->at += count;
}

class Reader {
  public:
    explicit Reader(std::span<const std::byte> file) : source_{file} {
        png_ = png_create_read_struct(PNG_LIBPNG_VER_STRING, &complaint_, png_fail,
                                      png_ignore);
        info_ = png_ != nullptr ? png_create_info_struct(png_) : nullptr;
        if (info_ == nullptr) {
            png_destroy_read_struct(&png_, nullptr, nullptr);
            throw std::bad_alloc();
        }
    }
    ~Reader() { png_destroy_read_struct(&png_, &info_, nullptr); }
    Reader(const Reader&) = delete;
    Reader& operator=(const Reader&) = delete;

    void header() { check(read_header()); }
    void prepare() { check(set_transforms()); }
    void pixels(png_bytepp rows) { check(read_rows(rows)); }
    void end() { check(read_end()); }

    int width() const { return static_cast<int>(png_get_image_width(png_, info_)); }
    int height() const { return static_cast<int>(png_get_image_height(png_, info_)); }
    int channels() const { return png_get_channels(png_, info_); }
    bool is_deep() const { return png_get_bit_depth(png_, info_) == 16; }

    /// Of what `prepare` will make, for its checks.
    int channels_to_come() const {
        const int type = png_get_color_type(png_, info_);
        const bool clear = png_get_valid(png_, info_, PNG_INFO_tRNS) != 0;
        return ((type & PNG_COLOR_MASK_COLOR) != 0 ? 3 : 1) +
               ((type & PNG_COLOR_MASK_ALPHA) != 0 || clear ? 1 : 0);
    }
    Metadata texts() const {
        png_textp texts = nullptr;
        const int count = png_get_text(png_, info_, &texts, nullptr);
        Metadata metadata;
        for (int i = 0; i < count; ++i) {
            metadata.emplace_back(std::string(texts[i].key),
                                  std::string(texts[i].text ? texts[i].text : ""));
        }
        return metadata;
    }

  private:
    void check(bool done) const {
        if (!done) {
            fail_to_read(title, one_line(complaint_.text, "it cannot be decoded"));
        }
    }
    // No objects with destructors in these: see png_fail.
    bool read_header() {
        if (setjmp(png_jmpbuf(png_)) != 0) {
            return false;
        }
        png_set_read_fn(png_, &source_, take);
        // Our own limits come with our own words.
        png_set_user_limits(png_, 0x7fffffff, 0x7fffffff);
        png_set_chunk_malloc_max(png_, 8 << 20);
        png_read_info(png_, info_);
        return true;
    }
    bool set_transforms() {
        if (setjmp(png_jmpbuf(png_)) != 0) {
            return false;
        }
        png_set_expand(png_);
        if (std::endian::native == std::endian::little) {
            png_set_swap(png_);
        }
        png_set_interlace_handling(png_);
        png_read_update_info(png_, info_);
        return true;
    }
    bool read_rows(png_bytepp rows) {
        if (setjmp(png_jmpbuf(png_)) != 0) {
            return false;
        }
        png_read_image(png_, rows);
        return true;
    }
    bool read_end() {
        if (setjmp(png_jmpbuf(png_)) != 0) {
            return false;
        }
        png_read_end(png_, info_);
        return true;
    }

    Source source_;
    PngComplaint complaint_;
    png_structp png_ = nullptr;
    png_infop info_ = nullptr;
};

std::vector<std::string> names_of(int channels) {
    if (channels <= 2) {
        return channels == 1 ? std::vector<std::string>{"Y"}
                             : std::vector<std::string>{"Y", "A"};
    }
    return channels == 3 ? std::vector<std::string>{"R", "G", "B"}
                         : std::vector<std::string>{"R", "G", "B", "A"};
}

Image decode(std::span<const std::byte> file, ChannelChoice choice) {
    Reader reader(file);
    reader.header();
    Image image;
    image.width = reader.width();
    image.height = reader.height();
    image.channels = reader.channels_to_come();
    image.format = reader.is_deep() ? PixelFormat::u16 : PixelFormat::u8;
    const std::size_t pixel =
        value_bytes(image.format) * static_cast<std::size_t>(image.channels);
    check_image_size(reader.width(), reader.height(), static_cast<std::int64_t>(pixel));
    check_plausible(image.size_bytes(), file.size());
    reader.prepare();
    if (reader.channels() != image.channels) {
        fail_to_read(title, "its channels do not fit its header");
    }
    image.channel_names = names_of(image.channels);
    image.pixels = zeroed_pixels(image.size_bytes());
    std::vector<png_bytep> rows(static_cast<std::size_t>(image.height));
    auto* row = reinterpret_cast<png_bytep>(image.pixels.get());
    for (png_bytep& r : rows) {
        r = row;
        row += pixel * static_cast<std::size_t>(image.width);
    }
    reader.pixels(rows.data());
    if (choice == ChannelChoice::all) {
        // Text may also stand behind the pixels.
        reader.end();
        image.window = {0, 0, image.width, image.height};
        image.metadata = reader.texts();
    }
    return image;
}

}  // namespace

Image read_png(std::span<const std::byte> file, ChannelChoice choice) {
    try {
        return decode(file, choice);
    } catch (const std::bad_alloc&) {
        fail_to_read(title, "not enough memory to decode it");
    }
}

}  // namespace raykiln
