#pragma once

#include <stdexcept>
#include <string>
#include <utility>

namespace glue_rl {

/// The base class of this library's errors; a message names the cause and the remedy.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// An address, a session's name, a key or the environment is wrong.
class ConfigError : public Error {
 public:
  using Error::Error;
};

/// The program at the other end broke the protocol.
class ProtocolError : public Error {
 public:
  using Error::Error;
};

/// The hub refuses this program.
class Refused : public Error {
 public:
  using Error::Error;
};

/// The hub ended the session, or knows nothing of this experiment any more.
class HubClosed : public Error {
 public:
  using Error::Error;
};

/// The agent or environment that is served threw an exception, which is nested in this one; the hub is informed.
class PlayerThrew : public Error {
 public:
  using Error::Error;
};

/// A request of the experiment failed.
class RequestFailed : public Error {
 public:
  RequestFailed(std::string code, const std::string& text) : Error(text), code_(std::move(code)) {}

  /// The hub's code, such as `peer-lost`.
  const std::string& code() const noexcept { return code_; }

 private:
  std::string code_;
};

/// A player was lost, and the episode is void: start another. The hub waits for the player, or for another.
class PeerLost : public RequestFailed {
 public:
  using RequestFailed::RequestFailed;
};

/// A player failed in a call, or broke the protocol.
class PeerFailed : public RequestFailed {
 public:
  using RequestFailed::RequestFailed;
};

/// The player lacks the capability for this request.
class Unsupported : public RequestFailed {
 public:
  using RequestFailed::RequestFailed;
};

}  // namespace glue_rl
