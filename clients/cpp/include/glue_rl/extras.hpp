#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <variant>
#include <vector>

#include "detail/msgpack.hpp"

namespace glue_rl {

/// A value beside an observation: an int, a float, a text in UTF-8, bytes, or an array of ints or of floats.
using Extra = std::variant<std::int64_t, double, std::string, std::vector<std::uint8_t>, std::vector<std::int64_t>,
                           std::vector<double>>;

/// Named values beside an observation, which agents do not see: at most 64, with names of 1 to 64 printable characters,
/// and 65,535 bytes in all.
using Extras = std::map<std::string, Extra>;

namespace detail {

constexpr std::size_t kMaxBeside = 65535;  // bytes of a mask, and of extras
constexpr std::size_t kMaxName = 64;

inline void pack(Packer& packer, std::int64_t value) { packer.signed_integer(value); }
inline void pack(Packer& packer, double value) { packer.real(value); }
inline void pack(Packer& packer, const std::string& value) {
  if (!is_utf8(value)) throw std::invalid_argument("a text among the extras is not UTF-8; bytes are a vector");
  packer.text(value);
}
inline void pack(Packer& packer, const std::vector<std::uint8_t>& value) {
  packer.binary(std::string(value.begin(), value.end()));
}
template <class Number>
void pack(Packer& packer, const std::vector<Number>& value) {
  packer.array(value.size());
  for (const Number number : value) pack(packer, number);
}

inline std::size_t size_of(std::int64_t) { return 1; }
inline std::size_t size_of(double) { return 1; }
template <class Run>
std::size_t size_of(const Run& run) {
  return run.size();
}

/// Returns extras as they cross the wire: nothing if there are none.
inline std::string pack(const Extras& extras) {
  if (extras.empty()) return {};
  if (extras.size() > kMaxItems) {
    throw std::invalid_argument("an observation has at most 64 extras, not " + std::to_string(extras.size()));
  }
  Packer packer;
  packer.map(extras.size());
  std::size_t least = 0;  // no item is shorter than a byte
  for (const auto& [name, extra] : extras) {
    if (!is_name(name, kMaxName)) {
      throw std::invalid_argument("the name of an extra has 1 to 64 printable characters, not \"" + name + "\"");
    }
    least += std::visit([](const auto& value) { return size_of(value); }, extra);
    if (least > kMaxBeside) break;
    packer.text(name);
    std::visit([&packer](const auto& value) { pack(packer, value); }, extra);
  }
  least = std::max(least, packer.bytes().size());
  if (least > kMaxBeside) {
    throw std::invalid_argument("the extras of an observation have at most 65535 bytes, not " + std::to_string(least));
  }
  return packer.bytes();
}

/// Reads an array of numbers of one type, of which there is one or more.
template <class T>
std::vector<T> numbers(Unpacker& unpacker, std::uint64_t count, Unpacker::Type type) {
  std::vector<T> all;
  all.reserve(count);
  for (; count != 0; --count) {
    if (unpacker.next() != type) unpacker.fail("has an array that is neither of ints nor of floats");
    if constexpr (std::is_same_v<T, double>) {
      all.push_back(unpacker.real());
    } else {
      all.push_back(unpacker.signed_integer());
    }
  }
  return all;
}

/// Reads a value of extras.
inline Extra unpack_extra(Unpacker& unpacker) {
  using Type = Unpacker::Type;
  switch (unpacker.next()) {
    case Type::kInteger: return unpacker.signed_integer();
    case Type::kReal: return unpacker.real();
    case Type::kText: return std::string(unpacker.text());
    case Type::kBinary: {
      const std::string_view bytes = unpacker.binary();
      return std::vector<std::uint8_t>(bytes.begin(), bytes.end());
    }
    case Type::kArray: {
      const auto count = unpacker.array(unpacker.remaining());
      // The count is no more than the bytes that were received, so nothing large is allocated for a small message.
      if (unpacker.next() == Type::kReal) return numbers<double>(unpacker, count, Type::kReal);
      return numbers<std::int64_t>(unpacker, count, Type::kInteger);
    }
    default: unpacker.fail("has a value that is no number, text, bytes or array");
  }
}

/// Returns the extras that were received.
inline Extras unpack(std::string_view packed) {
  Extras extras;
  Unpacker unpacker(packed, "a map of extras");
  for (auto left = unpacker.map(); left != 0; --left) {
    const std::string name(unpacker.text());
    if (!is_name(name, kMaxName)) unpacker.fail("has a name that is not 1 to 64 printable characters");
    if (!extras.emplace(name, unpack_extra(unpacker)).second) unpacker.fail("has the name " + name + " twice");
  }
  unpacker.end();
  return extras;
}

}  // namespace detail

}  // namespace glue_rl
