#include "image/channels.h"

#include <algorithm>
#include <cctype>
#include <numeric>
#include <optional>
#include <string_view>

#include "error.h"

namespace raykiln {

namespace {

bool same_name(std::string_view a, std::string_view b) {
    return std::ranges::equal(a, b, [](unsigned char x, unsigned char y) {
        return std::tolower(x) == std::tolower(y);
    });
}

std::optional<int> find(const std::vector<std::string>& names, const std::string& name) {
    const auto found =
        std::ranges::find_if(names, [&](const auto& n) { return same_name(n, name); });
    if (found == names.end()) {
        return std::nullopt;
    }
    return static_cast<int>(found - names.begin());
}

// The indices of prefix + wanted, followed by the alpha channel if there is one.
std::vector<int> with_alpha(const std::vector<std::string>& names,
                            const std::string& prefix,
                            std::initializer_list<const char*> wanted) {
    std::vector<int> chosen;
    for (const char* name : wanted) {
        const auto index = find(names, prefix + name);
        if (!index) {
            return {};
        }
        chosen.push_back(*index);
    }
    if (const auto alpha = find(names, prefix + "A")) {
        chosen.push_back(*alpha);
    }
    return chosen;
}

std::vector<int> first_layer(const std::vector<std::string>& names) {
    for (const std::string& name : names) {
        const std::size_t dot = name.rfind('.');
        if (dot == std::string::npos) {
            continue;
        }
        auto chosen = with_alpha(names, name.substr(0, dot + 1), {"R", "G", "B"});
        if (!chosen.empty()) {
            return chosen;
        }
    }
    return {};
}

}  // namespace

std::vector<int> colour_channels(const std::vector<std::string>& names) {
    if (auto rgb = with_alpha(names, "", {"R", "G", "B"}); !rgb.empty()) {
        return rgb;
    }
    if (auto grey = with_alpha(names, "", {"Y"}); !grey.empty()) {
        return grey;
    }
    if (auto layer = first_layer(names); !layer.empty()) {
        return layer;
    }
    std::vector<int> all(names.size() <= 4 ? names.size() : 0);
    std::iota(all.begin(), all.end(), 0);
    return all;
}

std::vector<int> require_colour_channels(const std::vector<std::string>& names) {
    auto chosen = colour_channels(names);
    if (chosen.empty()) {
        throw ImageError("none of its " + std::to_string(names.size()) +
                         " channels is named R, G, B or Y");
    }
    return chosen;
}

}  // namespace raykiln
