#pragma once

#include <string>

namespace glue_rl::detail {

/// The one or two frames of a message, kept from one message to the next.
struct Frames {
  std::string header;
  std::string body;
  bool has_body = false;

  bool operator==(const Frames& other) const {
    return has_body == other.has_body && header == other.header && body == other.body;
  }
};

}  // namespace glue_rl::detail
