#pragma once

#include <string>
#include <vector>

namespace raykiln {

/// Which of a file's channels make up its colour, as indices in the order R, G, B(, A) or
/// Y(, A): by plain name, else those of the first layer that has R, G and B, else all of
/// at most four.  Empty if there is no such choice.
std::vector<int> colour_channels(const std::vector<std::string>& names);

/// The same, but throws ImageError if there is no such choice.
std::vector<int> require_colour_channels(const std::vector<std::string>& names);

}  // namespace raykiln
