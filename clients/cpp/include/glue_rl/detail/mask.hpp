#pragma once

#include <algorithm>
#include <cctype>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <sstream>
#include <string>
#include <string_view>
#include <vector>

#include "../extras.hpp"

namespace glue_rl::detail {

/// Returns the number of values of each int of an action; nothing if the task spec does not say all in whole numbers.
inline std::vector<std::size_t> mask_sizes(std::string_view task_spec) {
  std::string text(task_spec);
  for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  const auto actions = text.find("ACTIONS");
  const auto ints = text.find("INTS", std::min(actions, text.size()));
  const auto end = text.find("REWARDS", std::min(actions, text.size()));
  if (ints == text.npos || ints > end) return {};
  std::istringstream in(text.substr(ints + 4, end - ints - 4));
  std::vector<std::size_t> sizes;
  for (char sign; in >> sign && sign == '(';) {
    std::vector<std::int64_t> words;
    for (std::int64_t word; in >> word;) words.push_back(word);
    in.clear();
    if (words.size() == 2) words.insert(words.begin(), 1);
    constexpr std::int64_t kMost = 8 * kMaxBeside;
    if (!(in >> sign) || sign != ')' || words.size() != 3) return {};
    if (words[0] < 0 || words[0] > kMost - std::int64_t(sizes.size()) || words[2] < words[1]) return {};
    if (words[1] < INT32_MIN || words[2] > INT32_MAX) return {};  // no ints of an action, and their sum might overflow
    sizes.insert(sizes.end(), words[0], std::uint64_t(words[2]) - std::uint64_t(words[1]) + 1);
  }
  return sizes;
}

/// Returns why a mask does not fit ints of so many values; nothing if it does, or if nothing is known of them.
inline std::string mask_fault(const std::vector<bool>& mask, const std::vector<std::size_t>& sizes) {
  if (mask.empty() || sizes.empty()) return {};
  const std::size_t values = std::accumulate(sizes.begin(), sizes.end(), std::size_t{0});
  const auto beyond = mask.begin() + static_cast<std::ptrdiff_t>(std::min(values, mask.size()));
  const bool fits = mask.size() >= values && mask.size() <= (values + 7) / 8 * 8;
  if (!fits || std::find(beyond, mask.end(), true) != mask.end()) {
    return "it is of " + std::to_string(mask.size()) + " values, and the ints of an action have " + std::to_string(values);
  }
  std::size_t at = 0;
  for (std::size_t i = 0; i < sizes.size(); ++i) {
    bool legal = false;
    for (const std::size_t end = at + sizes[i]; at < end; ++at) legal |= mask[at];
    if (!legal) return "no value of int " + std::to_string(i) + " is legal";
  }
  return {};
}

}  // namespace glue_rl::detail
