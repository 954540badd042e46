#include "image/oiio_seam.h"

#include <mutex>

#include "image/limits.h"

namespace raykiln {

// An attribute that the linked version does not know is refused without harm: the same
// limits are checked again by our own code before pixels are read.
static void set_limits() {
    OIIO::attribute("debug", 0);  // else a library writes to our caller's stderr
    OIIO::attribute("limits:imagesize_MB", static_cast<int>(max_image_bytes >> 20));
    OIIO::attribute("limits:channels", max_image_channels);
    OIIO::attribute("limits:resolution", max_image_side);
    OIIO::geterror();
}

void prepare_oiio() {
    static std::once_flag once;
    std::call_once(once, set_limits);
}

std::string without_name(std::string message, const std::string& name) {
    const std::string quoted = "\"" + name + "\"";
    for (const std::string& text : {" (" + quoted + ")", " " + quoted, quoted, name}) {
        for (std::size_t at; (at = message.find(text)) != std::string::npos;) {
            message.erase(at, text.size());
        }
    }
    return message;
}

std::string one_line(const std::string& message, const char* fallback) {
    constexpr std::size_t longest = 240;
    const std::size_t begin = message.find_first_not_of(" \r\n\t");
    if (begin == std::string::npos) {
        return fallback;
    }
    std::string line =
        message.substr(begin, message.find_first_of("\r\n", begin) - begin);
    for (char& c : line) {
        // Files put their own bytes into messages; only plain ASCII may reach a terminal.
        c = (c < 0x20 || c > 0x7e) ? '?' : c;
    }
    return line.size() <= longest ? line : line.substr(0, longest) + "...";
}

}  // namespace raykiln
