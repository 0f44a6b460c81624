#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

#include "../errors.hpp"
#include "frames.hpp"
#include "message.hpp"

namespace glue_rl::detail {

/// ZMTP 3.1 with the mechanism NULL: the last appendix of docs/protocol-reference.md. Bytes, no sockets.
namespace zmtp {

constexpr unsigned kMore = 1;
constexpr unsigned kLong = 2;
constexpr unsigned kCommand = 4;

constexpr std::size_t kGreetingSize = 64;
constexpr std::size_t kMaxCommand = 4096;
constexpr std::size_t kMaxFrame = 2 * kMaxBody;  // an observation and an action

/// Returns the 64 bytes with which either side begins.
inline std::string greeting() {
  std::string bytes(kGreetingSize, '\0');
  bytes[0] = '\xff';
  bytes[9] = '\x7f';
  bytes[10] = 3;
  bytes[11] = 1;
  return bytes.replace(12, 4, "NULL");
}

/// What comes before the bytes of a frame.
struct Head {
  char bytes[9];
  std::size_t size;

  Head(unsigned flags, std::size_t length) : size(length < 256 ? 2 : 9) {
    bytes[0] = static_cast<char>(size == 2 ? flags : flags | kLong);
    for (std::size_t i = 1; i < size; ++i) bytes[i] = static_cast<char>(length >> 8 * (size - 1 - i));
  }
};

inline std::string command(std::string_view data) {
  const Head head(kCommand, data.size());
  return std::string(head.bytes, head.size).append(data);
}

/// Returns the command with which a DEALER follows the greeting.
inline std::string ready() {
  using namespace std::string_view_literals;
  return command("\5READY\13Socket-Type\0\0\0\6DEALER\10Identity\0\0\0\0"sv);
}

}  // namespace zmtp

/// Takes what a hub sends in pieces of any size, and makes messages and commands of it.
class FrameReader {
 public:
  enum class Item { kNothing, kGreeting, kCommand, kMessage };

  /// Returns where to put the next bytes, and how many; `received` says how many were put.
  std::pair<char*, std::size_t> room() {
    if (start_ == end_) {
      start_ = end_ = 0;
      if (buffer_.size() > kSmall) std::vector<char>(kSmall).swap(buffer_);
    } else if (end_ == buffer_.size()) {
      // The bytes here belong to a frame whose length has been checked.
      std::memmove(buffer_.data(), buffer_.data() + start_, end_ - start_);
      end_ -= start_;
      start_ = 0;
      if (end_ > buffer_.size() / 2) buffer_.resize(2 * buffer_.size());
    }
    return {buffer_.data() + end_, buffer_.size() - end_};
  }

  void received(std::size_t count) { end_ += count; }

  /// Returns what comes next; the frames of a message go to `frames`, a command is `command()`.
  Item next(Frames& frames) {
    if (!greeted_) return end_ < zmtp::kGreetingSize ? Item::kNothing : greet();
    while (true) {
      const auto* at = reinterpret_cast<const unsigned char*>(buffer_.data() + start_);
      const std::size_t there = end_ - start_;
      if (there < 2) return Item::kNothing;
      const unsigned flags = at[0];
      const std::size_t head = (flags & zmtp::kLong) != 0 ? 9 : 2;
      if (there < head) return Item::kNothing;
      std::uint64_t length = 0;
      for (std::size_t i = 1; i < head; ++i) length = length << 8 | at[i];
      check(flags, length);
      if (there - head < length) return Item::kNothing;
      const std::string_view data(buffer_.data() + start_ + head, length);
      start_ += head + length;
      if ((flags & zmtp::kCommand) != 0) {
        command_ = data;
        return Item::kCommand;
      }
      keep(more_ ? frames.body : frames.header, data);
      frames.has_body = more_;
      if (!more_) frames.body.clear();
      more_ = (flags & zmtp::kMore) != 0;
      if (!more_) return Item::kMessage;
    }
  }

  /// The command that came last, until there is `room` for what follows: one byte of length, its name, its data.
  std::string_view command() const noexcept { return command_; }

 private:
  static constexpr std::size_t kSmall = 1 << 16;

  /// Makes `to` a copy, which keeps little more room than that.
  static void keep(std::string& to, std::string_view data) {
    if (to.capacity() > kSmall && data.size() <= kSmall) std::string().swap(to);
    to.assign(data);
  }

  Item greet() {
    const char* greeting = buffer_.data();
    if (greeting[0] != '\xff' || (greeting[9] & 1) == 0 || greeting[10] < 3) {
      throw ProtocolError("it does not speak ZMTP 3: is this the address of a hub?");
    }
    const std::string mechanism(greeting + 12, strnlen(greeting + 12, 20));
    if (mechanism != "NULL") {
      throw ConfigError("the hub wants keys (" + mechanism + "): set GLUE_KEY and GLUE_HUB_KEY");
    }
    start_ = zmtp::kGreetingSize;
    greeted_ = true;
    return Item::kGreeting;
  }

  void check(unsigned flags, std::uint64_t length) const {
    const bool command = (flags & zmtp::kCommand) != 0;
    const bool more = (flags & zmtp::kMore) != 0;
    if (flags > (zmtp::kMore | zmtp::kLong | zmtp::kCommand) || (command && more)) {
      throw ProtocolError("a frame has the flags " + std::to_string(flags) + ", which do not exist");
    }
    if (!command && more_ && more) throw ProtocolError("a message has more than two frames");
    const std::size_t most = command ? zmtp::kMaxCommand : more_ ? zmtp::kMaxFrame : kMaxHeader;
    if (length > most) {
      throw ProtocolError("a frame has " + std::to_string(length) + " bytes, and " + std::to_string(most) +
                          " are allowed");
    }
  }

  std::vector<char> buffer_ = std::vector<char>(kSmall);
  std::size_t start_ = 0;
  std::size_t end_ = 0;
  bool greeted_ = false;
  bool more_ = false;  // whether the frame before was the first of two
  std::string_view command_;
};

}  // namespace glue_rl::detail
