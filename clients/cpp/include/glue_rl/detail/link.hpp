#pragma once

#include <algorithm>
#include <chrono>
#include <cstring>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "../options.hpp"
#include "message.hpp"
#include "plain_dealer.hpp"
#if GLUE_RL_KEYS  // needs libzmq
#include "curve_dealer.hpp"
#endif

namespace glue_rl::detail {

using Clock = std::chrono::steady_clock;

/// Returns one line of at most a thousand bytes, and of whole characters.
inline std::string clip(std::string_view text) {
  constexpr std::size_t kMaxText = 1000;
  std::string line(text.substr(0, kMaxText));
  std::replace_if(
      line.begin(), line.end(), [](char c) { return static_cast<unsigned char>(c) < 0x20; }, ' ');
  for (int i = 0; i < 3 && !is_utf8(line) && !line.empty(); ++i) line.pop_back();
  return is_utf8(line) ? line : std::string("a text that is not UTF-8");
}

/// A peer's place in a session: greetings, heartbeats, and reconnecting after a break.
class Link {
 public:
  Link(std::string role, const Options& options, std::vector<std::string> capabilities)
      : role_(std::move(role)), options_(options), capabilities_(std::move(capabilities)) {
    check_session(options.session);
    std::random_device random;  // of the operating system
    for (std::size_t i = 0; i < kInstance; ++i) instance_.push_back(static_cast<char>(random()));
    if (options.key.empty() && options.hub_key.empty()) {
      dealer_ = std::make_unique<PlainDealer>(options.hub, options.log);
    } else {
#if GLUE_RL_KEYS
      dealer_ = std::make_unique<CurveDealer>(options.hub, read_keys(options.key, options.hub_key));
#else
      throw ConfigError(
          "this program was built without keys: build it with libzmq and -DGLUE_RL_KEYS=1, or unset GLUE_KEY and "
          "GLUE_HUB_KEY");
#endif
    }
  }

  /// Returns whether the hub has welcomed us over the latest connection, as far as is known.
  bool welcomed() {
    dealer_->look();
    return welcomed_ && dealer_->connected() && dealer_->connections() == greeted_;
  }

  const std::string& session() const noexcept { return options_.session; }

  void log(std::string_view line) const { options_.log(line); }

  /// Checks that the hub accepts a body of this size.
  void check(std::size_t size) const {
    if (size > max_body_) {
      throw Error("a body has " + std::to_string(size) + " bytes, and the hub takes " + std::to_string(max_body_));
    }
  }

  /// Cuts off what is beside an observation and not for the hub, as the hub itself does for others.
  void cut(std::string& body, bool with_extras) const {
    std::uint16_t beside[2];  // the sizes of mask and extras, which are the end of the body
    std::memcpy(beside, body.data() + kCountsBeside, sizeof beside);
    if (!extras_ || !with_extras) {
      body.resize(body.size() - std::exchange(beside[1], std::uint16_t{0}));
    }
    if (!masks_) {
      body.erase(body.size() - beside[1] - beside[0], beside[0]);
      beside[0] = 0;
    }
    std::memcpy(body.data() + kCountsBeside, beside, sizeof beside);
  }

  void send(const Frames& frames) { dealer_->send(frames); }

  /// Sends a message without a body.
  void send(const Packer& header) {
    Frames frames;
    frames.header = header.bytes();
    dealer_->send(frames);
  }

  /// Receives the next call, reply, ERROR, NOTICE, or WELCOME over the latest connection, which lies in `frames`; returns
  /// nothing if there is none for a heartbeat.
  std::optional<Message> receive(Frames& frames) {
    try {
      if (!dealer_->receive(frames, heartbeat_, timeout_)) {
        idle();
        return std::nullopt;
      }
      received_ = Clock::now();
      const std::string_view body = frames.body;
      const Message message = decode(frames.header, frames.has_body ? &body : nullptr);
      if (message.session != options_.session) {
        if (message.kind == kError && message.session.empty()) log("the hub says: " + std::string(message.texts[1]));
        return std::nullopt;
      }
      if (!message.known) {
        send(error(message.seq, "unknown-kind", "this " + role_ + " does not know that kind"));
        return std::nullopt;
      }
      return control(message);
    } catch (const ProtocolError& error) {
      throw ProtocolError("the hub at " + options_.hub + " broke the protocol: " + error.what());
    }
  }

  /// Says goodbye, and leaves.
  void close(std::string_view reason) {
    if (welcomed()) {
      Packer goodbye;
      send(goodbye.begin(1, kGoodbye, session(), 0).text(clip(reason)));
    }
    welcomed_ = false;
    dealer_->leave();
  }

  /// Returns the ERROR with which a player answers.
  Packer error(std::uint64_t seq, std::string_view code, std::string_view text) const {
    Packer header;
    header.begin(2, kError, session(), seq).text(code).text(clip(text));
    return header;
  }

 private:
  static constexpr std::size_t kInstance = 16;

  std::optional<Message> control(const Message& message) {
    switch (message.kind) {
      case kHeartbeat:
        return std::nullopt;
      case kWelcome:
        return welcome(message);
      case kRefuse:
        throw Refused("the hub at " + options_.hub + " refused this " + role_ + ": " + std::string(message.texts[1]));
      case kGoodbye:
        welcomed_ = false;  // a goodbye has no answer
        throw HubClosed(std::string(message.texts[0]));
      case kError:
        if (message.texts[0] != "unknown-peer") return message;
        dealer_->look();
        // While a HELLO is unanswered, this error is about something sent before it.
        if (welcomed_ || dealer_->connections() != greeted_) greet();
        return std::nullopt;
      default:
        return message;
    }
  }

  void greet() {
    welcomed_ = false;
    greeted_ = dealer_->connections();
    Packer hello;
    hello.begin(6, kHello, session(), greeted_).array(1).integer(1).text(role_).binary(instance_);
    hello.text(options_.name).text("C++").array(capabilities_.size());
    for (const auto& capability : capabilities_) hello.text(capability);
    send(hello);
  }

  std::optional<Message> welcome(const Message& message) {
    // A WELCOME to an earlier HELLO may be another hub's; a second one to the same HELLO says nothing new.
    if (message.seq != greeted_ || welcomed_) return std::nullopt;
    if (message.ints[0] != 1) throw ProtocolError("a version was chosen that was not offered");
    heartbeat_ = at_most(60.0, message.floats[0]);
    timeout_ = std::max(at_most(86400.0, message.floats[1]), heartbeat_);
    max_body_ = std::min<std::uint64_t>(message.ints[1], kMaxBody);
    const auto& confirmed = message.capabilities;
    masks_ = std::find(confirmed.begin(), confirmed.end(), "mask") != confirmed.end();
    extras_ = std::find(confirmed.begin(), confirmed.end(), "extras") != confirmed.end();
    if (waiting_) log("the hub at " + options_.hub + " is there");
    waiting_ = false;
    welcomed_ = true;
    return message;
  }

  /// Returns a time in which one can wait, whatever a hub says; what is no number becomes the least.
  static Milliseconds at_most(double most, double seconds) {
    return Milliseconds(static_cast<int>(1000 * (seconds > 0.01 ? std::min(seconds, most) : 0.01)));
  }

  void idle() {
    if (!dealer_->connected()) {
      welcomed_ = false;
    } else if (dealer_->connections() != greeted_) {
      greet();
      return;
    }
    const auto now = Clock::now();
    if (welcomed_) {
      if (now - received_ >= heartbeat_) {
        Packer heartbeat;
        send(heartbeat.begin(0, kHeartbeat, session(), 0));
      }
    } else if (!waiting_ && now - received_ >= heartbeat_) {
      waiting_ = true;
      log("no hub answers at " + options_.hub + " yet; waiting for one (glue-hub and glue-experiment start one)");
    }
  }

  static void check_session(const std::string& session) {
    if (!is_name(session, kMaxSession)) {
      throw ConfigError("the name of a session has 1 to 255 printable characters, not \"" + session + "\"");
    }
  }

  std::string role_;
  Options options_;
  std::vector<std::string> capabilities_;
  std::string instance_;
  std::unique_ptr<Dealer> dealer_;
  Milliseconds heartbeat_{1000};
  Milliseconds timeout_{5000};
  std::size_t max_body_ = kMaxBody;
  bool masks_ = false;   // whether the hub takes them; an older one does not
  bool extras_ = false;
  std::uint64_t greeted_ = 0;  // the connection that was greeted last; also the seq of that HELLO
  bool welcomed_ = false;      // over that connection
  bool waiting_ = false;       // for a hub, and has said so
  Clock::time_point received_ = Clock::now();
};

}  // namespace glue_rl::detail
