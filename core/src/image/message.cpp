#include "image/message.h"

#include "error.h"

namespace raykiln {

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

void fail_to_read(const char* title, const std::string& what) {
    throw ImageError(std::string("damaged or unsupported ") + title + " image: " + what);
}

void fail_to_write(const char* kind, const std::string& what) {
    throw ImageError(std::string("cannot encode the ") + kind + " image: " + what);
}

}  // namespace raykiln
