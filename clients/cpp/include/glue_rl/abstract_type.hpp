#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <string>
#include <string_view>
#include <vector>

#include "errors.hpp"
#include "extras.hpp"

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "observations are read where they lie, which needs a little-endian machine"
#endif

namespace glue_rl {

namespace detail {

constexpr std::size_t kHead = 16;          // bytes before the runs: four counts of 32 bits
constexpr std::size_t kCountsBeside = 12;  // where the sizes of mask and extras are, of 16 bits each

}  // namespace detail

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

  /// Takes the action that `body` begins with, and leaves what follows it in `body`.
  static AbstractView take(std::string_view& body) {
    AbstractView view;
    if (view.read(body) != 0) throw ProtocolError("bytes 12 to 15 of an action are zero");
    return view;
  }

 protected:
  /// Takes all but what lies beside an observation; returns the sizes of that.
  std::uint32_t read(std::string_view& body) {
    if (body.size() < detail::kHead) {
      throw ProtocolError("an observation or action has 16 bytes or more, not " + std::to_string(body.size()));
    }
    std::uint32_t counts[4];
    std::memcpy(counts, body.data(), detail::kHead);
    const std::uint64_t ints = counts[0], doubles = counts[1], chars = counts[2];
    const std::uint64_t size = detail::kHead + 8 * doubles + 4 * ints + chars;
    if (size > body.size()) {
      throw ProtocolError("an observation or action has " + std::to_string(body.size()) +
                          " bytes, and by its counts " + std::to_string(size));
    }
    const char* at = body.data() + detail::kHead;
    doubles_ = Run<double>(at, doubles);
    ints_ = Run<std::int32_t>(at + 8 * doubles, ints);
    chars_ = body.substr(detail::kHead + 8 * doubles + 4 * ints, chars);
    body.remove_prefix(size);
    return counts[3];
  }

 private:
  Run<std::int32_t> ints_;
  Run<double> doubles_;
  std::string_view chars_;
};

/// An observation where it was received; valid until the method that it was passed to returns.
class ObservationView : public AbstractView {
 public:
  ObservationView() = default;
  explicit ObservationView(const AbstractView& view) : AbstractView(view) {}

  /// Returns whether a value of the next action is legal: all are, unless there is a mask. The values of its ints are
  /// numbered from 0, one int after another, each from its minimum: after an int from 0 to 2, 3 is the minimum of the
  /// next.
  bool legal(std::size_t value) const noexcept {
    if (mask_.empty()) return true;
    return value / 8 < mask_.size() && (static_cast<unsigned char>(mask_[value / 8]) >> value % 8 & 1) != 0;
  }

  /// Copies the mask: what `legal` says of each value, and false up to a multiple of 8; empty if there is none.
  std::vector<bool> mask() const {
    std::vector<bool> copy(8 * mask_.size());
    for (std::size_t i = 0; i < copy.size(); ++i) copy[i] = legal(i);
    return copy;
  }

  /// Takes the observation that `body` begins with, and leaves what follows it in `body`.
  static ObservationView take(std::string_view& body, bool with_extras) {
    ObservationView view;
    const std::uint32_t sizes = view.read(body);
    const std::size_t mask = sizes & 0xffff, extras = sizes >> 16;
    if (extras != 0 && !with_extras) throw ProtocolError("an agent was sent extras, which are not for it");
    if (mask + extras > body.size()) throw ProtocolError("an observation ends in the middle of its mask or extras");
    view.mask_ = body.substr(0, mask);
    view.extras_ = body.substr(mask, extras);
    body.remove_prefix(mask + extras);
    return view;
  }

 private:
  friend struct Observation;

  std::string_view mask_;
  std::string_view extras_;
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

  /// Makes `body` what crosses the wire.
  void write(std::string& body) const {
    const std::uint32_t counts[4] = {static_cast<std::uint32_t>(ints.size()),
                                     static_cast<std::uint32_t>(doubles.size()),
                                     static_cast<std::uint32_t>(chars.size()), 0};
    body.resize(detail::kHead + 8 * doubles.size() + 4 * ints.size() + chars.size());
    char* to = put(body.data(), counts, sizeof counts);
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

using Action = AbstractType;
using ActionView = AbstractView;

/// An observation, and what is beside it.
struct Observation : AbstractType {
  using AbstractType::AbstractType;
  Observation() = default;
  Observation(AbstractType runs) : AbstractType(std::move(runs)) {}
  explicit Observation(const ObservationView& view)
      : AbstractType(view), mask(view.mask()), extras(view.extras_.empty() ? Extras() : detail::unpack(view.extras_)) {}

  /// Which values of the next action are legal, as `ObservationView::legal` numbers them; empty if all are. An
  /// environment with masks has the word `masks` in its task spec's EXTRA.
  std::vector<bool> mask;
  /// Named values for everyone but the agent.
  Extras extras;

  /// Makes `body` what crosses the wire; throws std::invalid_argument if it cannot.
  void write(std::string& body) const {
    AbstractType::write(body);
    const std::string packed = detail::pack(extras);
    const std::size_t start = body.size(), size = (mask.size() + 7) / 8;
    if (size > detail::kMaxBeside) throw std::invalid_argument("a mask has at most 524280 values");
    body.append(size, '\0');
    for (std::size_t i = 0; i < mask.size(); ++i) {
      if (mask[i]) body[start + i / 8] = static_cast<char>(body[start + i / 8] | 1 << i % 8);
    }
    body += packed;
    const std::uint16_t beside[2] = {static_cast<std::uint16_t>(size), static_cast<std::uint16_t>(packed.size())};
    std::memcpy(body.data() + detail::kCountsBeside, beside, sizeof beside);
  }
};

}  // namespace glue_rl
