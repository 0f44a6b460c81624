#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>

#include "../errors.hpp"

namespace glue_rl::detail {

constexpr std::uint64_t kMaxItems = 64;
constexpr std::uint64_t kMaxInt = (std::uint64_t{1} << 63) - 1;
constexpr std::int64_t kMaxExact = std::int64_t{1} << 53;

/// Writes msgpack, item by item: a header, which is an array, or extras, which are a map.
class Packer {
 public:
  Packer& array(std::size_t items) {
    if (items < 16) return byte(0x90 | items);
    return byte(0xdc).big_endian(items, 2);
  }

  /// Begins a map of up to 65,535 items, each a key and a value.
  Packer& map(std::size_t items) {
    if (items < 16) return byte(0x80 | items);
    return byte(0xde).big_endian(items, 2);
  }

  Packer& integer(std::uint64_t value) {
    if (value > kMaxInt) throw Error("integers are from 0 to 2^63 - 1, not " + std::to_string(value));
    if (value < 0x80) return byte(value);
    const int power = value < 0x100 ? 0 : value < 0x10000 ? 1 : value < 0x100000000 ? 2 : 3;
    return byte(0xcc + static_cast<unsigned>(power)).big_endian(value, 1 << power);
  }

  Packer& signed_integer(std::int64_t value) {
    if (value >= 0) return integer(static_cast<std::uint64_t>(value));
    if (value >= -32) return byte(static_cast<std::uint8_t>(value));
    const int power = value >= INT8_MIN ? 0 : value >= INT16_MIN ? 1 : value >= INT32_MIN ? 2 : 3;
    return byte(0xd0 + static_cast<unsigned>(power)).big_endian(static_cast<std::uint64_t>(value), 1 << power);
  }

  Packer& real(double value) {
    std::uint64_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return byte(0xcb).big_endian(bits, 8);
  }

  Packer& truth(bool value) { return byte(value ? 0xc3 : 0xc2); }

  Packer& nil() { return byte(0xc0); }

  Packer& text(std::string_view value) {
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

  /// Writes up to 65,535 bytes.
  Packer& binary(std::string_view value) {
    const int power = value.size() < 0x100 ? 0 : 1;
    byte(0xc4 + static_cast<unsigned>(power)).big_endian(value.size(), 1 << power);
    bytes_.append(value);
    return *this;
  }

  /// Begins the header of a message with this many scalars.
  Packer& begin(std::size_t scalars, std::uint64_t kind, std::string_view session, std::uint64_t seq) {
    bytes_.clear();
    return array(3 + scalars).integer(kind).text(session).integer(seq);
  }

  const std::string& bytes() const noexcept { return bytes_; }

 private:
  Packer& byte(std::size_t value) {
    bytes_.push_back(static_cast<char>(value));
    return *this;
  }

  Packer& big_endian(std::uint64_t value, int size) {
    for (int shift = 8 * size - 8; shift >= 0; shift -= 8) bytes_.push_back(static_cast<char>(value >> shift));
    return *this;
  }

  std::string bytes_;
};

/// Returns the number of characters of a text in UTF-8.
inline std::size_t characters(std::string_view text) {
  return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char c) { return (c & 0xc0) != 0x80; }));
}

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

/// Returns whether a text is a name: UTF-8, 1 to `most` characters, none of them for control.
inline bool is_name(std::string_view text, std::size_t most) {
  const bool printable =
      std::none_of(text.begin(), text.end(), [](char c) { return static_cast<unsigned char>(c) < 0x20 || c == 0x7f; });
  return printable && is_utf8(text) && characters(text) >= 1 && characters(text) <= most;
}

/// Reads msgpack, item by item; anything but what is asked for is a ProtocolError.
class Unpacker {
 public:
  enum class Type { kInteger, kReal, kText, kBinary, kArray, kOther };

  /// Reads `bytes`, which errors call `what`.
  Unpacker(std::string_view bytes, const char* what) : bytes_(bytes), what_(what) {}

  /// Returns the type of the next item, and reads nothing.
  Type next() const {
    const unsigned tag = bytes_.empty() ? 0xc1 : static_cast<unsigned char>(bytes_[0]);
    if (tag < 0x80 || tag >= 0xe0 || (tag >= 0xcc && tag <= 0xd3)) return Type::kInteger;
    if (tag == 0xca || tag == 0xcb) return Type::kReal;
    if ((tag & 0xe0) == 0xa0 || (tag >= 0xd9 && tag <= 0xdb)) return Type::kText;
    if (tag >= 0xc4 && tag <= 0xc6) return Type::kBinary;
    return (tag & 0xf0) == 0x90 || tag == 0xdc || tag == 0xdd ? Type::kArray : Type::kOther;
  }

  /// Returns the number of items of an array, whose items come next.
  std::uint64_t array(std::uint64_t most = kMaxItems) { return items(0x90, 0xdc, "an array", most, 1); }

  /// Returns the number of items of a map; of each the key comes next, and then the value.
  std::uint64_t map() { return items(0x80, 0xde, "a map", kMaxItems, 2); }

  /// Returns how many bytes have not been read, which is no less than the number of items.
  std::size_t remaining() const noexcept { return bytes_.size(); }

  std::uint64_t integer() {
    std::uint64_t value = 0;
    bool negative = false;
    if (!any_integer(next_tag(), value, negative)) unexpected("an integer");
    if (negative || value > kMaxInt) fail("has an integer that is not from 0 to 2^63 - 1");
    return value;
  }

  std::int64_t signed_integer() {
    std::uint64_t value = 0;
    bool negative = false;
    if (!any_integer(next_tag(), value, negative)) unexpected("an integer");
    if (!negative && value > kMaxInt) fail("has an integer beyond 2^63 - 1");
    return static_cast<std::int64_t>(value);
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
      fail("has a float that is an integer beyond 2^53");
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
    if (!is_utf8(utf8)) fail("has a text that is not UTF-8");
    return utf8;
  }

  std::string_view binary() {
    const unsigned tag = next_tag();
    if (tag < 0xc4 || tag > 0xc6) unexpected("bytes");
    return take(unsigned_integer(1 << (tag - 0xc4)));
  }

  /// Checks that nothing follows.
  void end() const {
    if (left_ != 0 || !bytes_.empty()) fail("has more items than it should have");
  }

  [[noreturn]] void fail(const std::string& text) const { throw ProtocolError(what_ + (" " + text)); }

 private:
  std::uint64_t items(unsigned short_tag, unsigned long_tag, const char* type, std::uint64_t most, std::uint64_t each) {
    const unsigned tag = next_tag();
    std::uint64_t count = 0;
    if ((tag & 0xf0) == short_tag) {
      count = tag & 0x0f;
    } else if (tag == long_tag || tag == long_tag + 1) {
      count = unsigned_integer(tag == long_tag ? 2 : 4);
    } else {
      unexpected(type);
    }
    if (count > most) {
      fail("has " + std::string(type) + " of " + std::to_string(count) + " items, and at most " + std::to_string(most) +
           " are allowed");
    }
    left_ += each * count;
    return count;
  }

  unsigned next_tag() {
    if (left_ == 0) fail("has fewer items than it should have");
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
    if (size > bytes_.size()) fail("ends in the middle of an item");
    const std::string_view taken = bytes_.substr(0, size);
    bytes_.remove_prefix(size);
    return taken;
  }

  [[noreturn]] void unexpected(const char* expected) const {
    fail(std::string("has something else where ") + expected + " was expected");
  }

  std::string_view bytes_;
  const char* what_;
  std::uint64_t left_ = 1;  // items that have not been read
};

}  // namespace glue_rl::detail
