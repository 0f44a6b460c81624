#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <string>
#include <string_view>
#include <vector>

#include "errors.hpp"

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "observations are read where they lie, which needs a little-endian machine"
#endif

namespace glue_rl {

/// A run of numbers where they were received: nothing is copied, and they need not be aligned.
template <class T>
class Run {
 public:
  class iterator {
   public:
    using iterator_category = std::input_iterator_tag;
    using value_type = T;
    using difference_type = std::ptrdiff_t;
    using pointer = const T*;
    using reference = T;

    explicit iterator(const char* at) : at_(at) {}
    T operator*() const { return read(at_); }
    iterator& operator++() {
      at_ += sizeof(T);
      return *this;
    }
    iterator operator++(int) {
      iterator before = *this;
      ++*this;
      return before;
    }
    bool operator==(iterator other) const { return at_ == other.at_; }
    bool operator!=(iterator other) const { return at_ != other.at_; }

   private:
    const char* at_;
  };

  Run() = default;
  Run(const char* data, std::size_t size) : data_(data), size_(size) {}

  std::size_t size() const noexcept { return size_; }
  bool empty() const noexcept { return size_ == 0; }
  T operator[](std::size_t i) const { return read(data_ + i * sizeof(T)); }
  T front() const { return (*this)[0]; }
  T back() const { return (*this)[size_ - 1]; }
  iterator begin() const { return iterator(data_); }
  iterator end() const { return iterator(data_ + size_ * sizeof(T)); }

  /// Copies all of them.
  std::vector<T> to_vector() const {
    std::vector<T> copy(size_);
    if (size_ != 0) std::memcpy(copy.data(), data_, size_ * sizeof(T));
    return copy;
  }

 private:
  static T read(const char* at) {
    T value;
    std::memcpy(&value, at, sizeof value);
    return value;
  }

  const char* data_ = nullptr;
  std::size_t size_ = 0;
};

/// RL-Glue's abstract type where it was received; valid until the method that it was passed to returns.
class AbstractView {
 public:
  AbstractView() = default;

  /// 32-bit integers.
  Run<std::int32_t> ints() const noexcept { return ints_; }
  Run<double> doubles() const noexcept { return doubles_; }
  /// Bytes.
  std::string_view chars() const noexcept { return chars_; }

  /// Takes the abstract type that `body` begins with, and leaves what follows it in `body`.
  static AbstractView take(std::string_view& body) {
    if (body.size() < kHead) {
      throw ProtocolError("an observation or action has 16 bytes or more, not " + std::to_string(body.size()));
    }
    std::uint32_t counts[4];
    std::memcpy(counts, body.data(), kHead);
    const std::uint64_t ints = counts[0], doubles = counts[1], chars = counts[2];
    if (counts[3] != 0) throw ProtocolError("bytes 12 to 15 of an observation or action are zero");
    const std::uint64_t size = kHead + 8 * doubles + 4 * ints + chars;
    if (size > body.size()) {
      throw ProtocolError("an observation or action has " + std::to_string(body.size()) +
                          " bytes, and by its counts " + std::to_string(size));
    }
    AbstractView view;
    const char* at = body.data() + kHead;
    view.doubles_ = Run<double>(at, doubles);
    view.ints_ = Run<std::int32_t>(at + 8 * doubles, ints);
    view.chars_ = body.substr(kHead + 8 * doubles + 4 * ints, chars);
    body.remove_prefix(size);
    return view;
  }

 private:
  static constexpr std::size_t kHead = 16;

  Run<std::int32_t> ints_;
  Run<double> doubles_;
  std::string_view chars_;
};

/// RL-Glue's abstract type: three runs of numbers, each of any length.
struct AbstractType {
  std::vector<std::int32_t> ints;
  std::vector<double> doubles;
  /// Bytes.
  std::string chars;

  AbstractType() = default;
  AbstractType(std::vector<std::int32_t> some_ints, std::vector<double> some_doubles = {}, std::string some_chars = {})
      : ints(std::move(some_ints)), doubles(std::move(some_doubles)), chars(std::move(some_chars)) {}
  explicit AbstractType(const AbstractView& view)
      : ints(view.ints().to_vector()), doubles(view.doubles().to_vector()), chars(view.chars()) {}

  /// Its size as it crosses the wire, in bytes.
  std::size_t body_size() const noexcept { return 16 + 8 * doubles.size() + 4 * ints.size() + chars.size(); }

  /// Writes it as it crosses the wire: `body_size()` bytes.
  void write(char* to) const noexcept {
    const std::uint32_t counts[4] = {static_cast<std::uint32_t>(ints.size()),
                                     static_cast<std::uint32_t>(doubles.size()),
                                     static_cast<std::uint32_t>(chars.size()), 0};
    to = put(to, counts, sizeof counts);
    to = put(to, doubles.data(), 8 * doubles.size());
    to = put(to, ints.data(), 4 * ints.size());
    put(to, chars.data(), chars.size());
  }

 private:
  static char* put(char* to, const void* from, std::size_t size) noexcept {
    if (size != 0) std::memcpy(to, from, size);
    return to + size;
  }
};

using Observation = AbstractType;
using Action = AbstractType;
using ObservationView = AbstractView;
using ActionView = AbstractView;

}  // namespace glue_rl
