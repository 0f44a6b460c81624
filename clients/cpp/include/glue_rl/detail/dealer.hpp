#pragma once

#include <chrono>
#include <cstdint>

#include "frames.hpp"

namespace glue_rl::detail {

using Milliseconds = std::chrono::milliseconds;

/// A ZeroMQ DEALER that knows its connections: one after another to the same address.
class Dealer {
 public:
  Dealer() = default;
  Dealer(const Dealer&) = delete;
  Dealer& operator=(const Dealer&) = delete;
  virtual ~Dealer() = default;

  /// Counts the connections.
  std::uint64_t connections() const noexcept { return connections_; }

  /// Whether there is a connection that can carry messages, as far as is known.
  bool connected() const noexcept { return connected_; }

  /// Notices connections that were made or lost meanwhile.
  virtual void look() = 0;

  /// Receives the next message; returns false if there is none within `time`, or a connection was made or lost. A
  /// connection that was silent for `timeout` is given up.
  virtual bool receive(Frames& frames, Milliseconds time, Milliseconds timeout) = 0;

  /// Sends a message. Without a connection it is lost, as when one breaks: the hub asks again.
  virtual void send(const Frames& frames) = 0;

  /// Makes no further connection; messages already sent are still delivered.
  virtual void leave() noexcept = 0;

 protected:
  std::uint64_t connections_ = 0;
  bool connected_ = false;
};

}  // namespace glue_rl::detail
