#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

#include "../errors.hpp"

namespace glue_rl::detail {

constexpr std::size_t kMaxHeader = 4096;
constexpr std::uint64_t kMaxItems = 64;
constexpr std::uint64_t kMaxInt = (std::uint64_t{1} << 63) - 1;
constexpr std::int64_t kMaxExact = std::int64_t{1} << 53;

/// Writes a header, a msgpack array, item by item.
class HeaderWriter {
 public:
  HeaderWriter& array(std::size_t items) {
    if (items < 16) return byte(0x90 | items);
    return byte(0xdc).big_endian(items, 2);
  }

  HeaderWriter& integer(std::uint64_t value) {
    if (value < 0x80) return byte(value);
    const int power = value < 0x100 ? 0 : value < 0x10000 ? 1 : value < 0x100000000 ? 2 : 3;
    return byte(0xcc + static_cast<unsigned>(power)).big_endian(value, 1 << power);
  }

  HeaderWriter& real(double value) {
    std::uint64_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return byte(0xcb).big_endian(bits, 8);
  }

  HeaderWriter& truth(bool value) { return byte(value ? 0xc3 : 0xc2); }

  HeaderWriter& nil() { return byte(0xc0); }

  HeaderWriter& text(std::string_view value) {
    if (value.size() < 32) {
      byte(0xa0 | value.size());
    } else if (value.size() < 0x100) {
      byte(0xd9).big_endian(value.size(), 1);
    } else {
      byte(0xda).big_endian(value.size(), 2);
    }
    bytes_.append(value);
    return *this;
  }

  /// Writes up to 255 bytes.
  HeaderWriter& binary(std::string_view value) {
    byte(0xc4).big_endian(value.size(), 1);
    bytes_.append(value);
    return *this;
  }

  /// Begins the header of a message with this many scalars.
  HeaderWriter& begin(std::size_t scalars, std::uint64_t kind, std::string_view session, std::uint64_t seq) {
    bytes_.clear();
    return array(3 + scalars).integer(kind).text(session).integer(seq);
  }

  const std::string& bytes() const noexcept { return bytes_; }

 private:
  HeaderWriter& byte(std::size_t value) {
    bytes_.push_back(static_cast<char>(value));
    return *this;
  }

  HeaderWriter& big_endian(std::uint64_t value, int size) {
    for (int shift = 8 * size - 8; shift >= 0; shift -= 8) bytes_.push_back(static_cast<char>(value >> shift));
    return *this;
  }

  std::string bytes_;
};

/// Returns whether a text is UTF-8: no overlong form, no surrogate, nothing beyond U+10FFFF.
inline bool is_utf8(std::string_view text) {
  const auto* at = reinterpret_cast<const unsigned char*>(text.data());
  const auto* end = at + text.size();
  while (at != end) {
    const unsigned first = *at++;
    if (first < 0x80) continue;
    const int more = first >= 0xf0 ? 3 : first >= 0xe0 ? 2 : 1;
    if (first < 0xc2 || first > 0xf4 || end - at < more) return false;
    const unsigned low = first == 0xe0 ? 0xa0 : first == 0xf0 ? 0x90 : 0x80;
    const unsigned high = first == 0xed ? 0x9f : first == 0xf4 ? 0x8f : 0xbf;
    if (*at < low || *at > high) return false;
    for (int i = 1; i < more; ++i) {
      if ((at[i] & 0xc0) != 0x80) return false;
    }
    at += more;
  }
  return true;
}

/// Reads a header, item by item; anything but what is asked for is a ProtocolError.
class HeaderReader {
 public:
  explicit HeaderReader(std::string_view header) : bytes_(header) {
    if (header.size() > kMaxHeader) {
      throw ProtocolError("a header has at most 4096 bytes, not " + std::to_string(header.size()));
    }
  }

  /// Returns the number of items of an array, whose items come next.
  std::uint64_t array() {
    const unsigned tag = next_tag();
    std::uint64_t items = 0;
    if ((tag & 0xf0) == 0x90) {
      items = tag & 0x0f;
    } else if (tag == 0xdc || tag == 0xdd) {
      items = unsigned_integer(tag == 0xdc ? 2 : 4);
    } else {
      unexpected("an array");
    }
    if (items > kMaxItems) {
      throw ProtocolError("an array of a header has at most 64 items, not " + std::to_string(items));
    }
    left_ += items;
    return items;
  }

  std::uint64_t integer() {
    std::uint64_t value = 0;
    bool negative = false;
    if (!any_integer(next_tag(), value, negative)) unexpected("an integer");
    if (negative || value > kMaxInt) throw ProtocolError("a header has an integer that is not from 0 to 2^63 - 1");
    return value;
  }

  double real() {
    const unsigned tag = next_tag();
    if (tag == 0xcb) {
      const std::uint64_t bits = unsigned_integer(8);
      double value;
      std::memcpy(&value, &bits, sizeof value);
      return value;
    }
    if (tag == 0xca) {
      const auto bits = static_cast<std::uint32_t>(unsigned_integer(4));
      float value;
      std::memcpy(&value, &bits, sizeof value);
      return value;
    }
    std::uint64_t value = 0;
    bool negative = false;
    if (!any_integer(tag, value, negative)) unexpected("a float");
    const auto whole = static_cast<std::int64_t>(value);
    if (negative ? whole < -kMaxExact : value > static_cast<std::uint64_t>(kMaxExact)) {
      throw ProtocolError("a header has a float that is an integer beyond 2^53");
    }
    return static_cast<double>(whole);
  }

  /// Reads a bool, which may be an integer: all but 0 are true.
  std::uint64_t truth() {
    const unsigned tag = next_tag();
    if (tag == 0xc2 || tag == 0xc3) return tag == 0xc3;
    std::uint64_t value = 0;
    bool negative = false;
    if (!any_integer(tag, value, negative)) unexpected("a bool");
    return value;
  }

  std::string_view text() {
    const unsigned tag = next_tag();
    std::uint64_t size = 0;
    if ((tag & 0xe0) == 0xa0) {
      size = tag & 0x1f;
    } else if (tag >= 0xd9 && tag <= 0xdb) {
      size = unsigned_integer(1 << (tag - 0xd9));
    } else {
      unexpected("a text");
    }
    const std::string_view utf8 = take(size);
    if (!is_utf8(utf8)) throw ProtocolError("a text of a header is not UTF-8");
    return utf8;
  }

  /// Checks that nothing follows.
  void end() const {
    if (left_ != 0 || !bytes_.empty()) throw ProtocolError("a header has other items than its kind says");
  }

 private:
  unsigned next_tag() {
    if (left_ == 0) throw ProtocolError("a header has fewer items than its kind says");
    left_ -= 1;
    return static_cast<unsigned char>(take(1)[0]);
  }

  /// Reads the integer that a tag begins, as two's complement; returns false if it begins another type.
  bool any_integer(unsigned tag, std::uint64_t& value, bool& negative) {
    if (tag < 0x80) {
      value = tag;
    } else if (tag >= 0xcc && tag <= 0xcf) {
      value = unsigned_integer(1 << (tag - 0xcc));
    } else if (tag >= 0xe0 || (tag >= 0xd0 && tag <= 0xd3)) {
      const int size = tag >= 0xe0 ? 1 : 1 << (tag - 0xd0);
      const std::uint64_t bits = tag >= 0xe0 ? tag : unsigned_integer(size);
      const int shift = 64 - 8 * size;
      value = static_cast<std::uint64_t>(static_cast<std::int64_t>(bits << shift) >> shift);
      negative = static_cast<std::int64_t>(value) < 0;
    } else {
      return false;
    }
    return true;
  }

  std::uint64_t unsigned_integer(int size) {
    std::uint64_t value = 0;
    for (const char byte : take(static_cast<std::uint64_t>(size))) {
      value = value << 8 | static_cast<unsigned char>(byte);
    }
    return value;
  }

  std::string_view take(std::uint64_t size) {
    if (size > bytes_.size()) throw ProtocolError("a header ends in the middle of an item");
    const std::string_view taken = bytes_.substr(0, size);
    bytes_.remove_prefix(size);
    return taken;
  }

  [[noreturn]] static void unexpected(const char* expected) {
    throw ProtocolError(std::string("a header has ") + expected + " where something else was received");
  }

  std::string_view bytes_;
  std::uint64_t left_ = 1;  // items that have not been read
};

}  // namespace glue_rl::detail
