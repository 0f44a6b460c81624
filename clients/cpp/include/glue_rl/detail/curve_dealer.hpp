#pragma once

#include <poll.h>
#include <zmq.h>

#include <cstdint>
#include <cstring>
#include <memory>
#include <new>
#include <string>
#include <string_view>

#include "../errors.hpp"
#include "address.hpp"
#include "dealer.hpp"
#include "keys.hpp"
#include "message.hpp"

namespace glue_rl::detail {

/// A DEALER of libzmq with the mechanism CURVE, for a hub that wants keys.
class CurveDealer final : public Dealer {
 public:
  CurveDealer(const std::string& hub, const Keys& keys) : hub_(hub) {
    addresses_of(hub);  // a mistake in it is an error, no reason to wait
    context_.reset(zmq_ctx_new());
    socket_.reset(zmq_socket(context_.get(), ZMQ_DEALER));
    set(ZMQ_LINGER, 1000);
    set(ZMQ_RCVHWM, 0);
    set(ZMQ_HEARTBEAT_IVL, 1000);
    set(ZMQ_HEARTBEAT_TIMEOUT, 5000);
    set(ZMQ_RECONNECT_IVL, 50);
    set(ZMQ_IPV6, 1);
    const auto most = static_cast<std::int64_t>(2 * kMaxBody);  // an observation and an action
    zmq_setsockopt(socket_.get(), ZMQ_MAXMSGSIZE, &most, sizeof most);
    set_key(ZMQ_CURVE_SERVERKEY, keys.hub);
    set_key(ZMQ_CURVE_PUBLICKEY, keys.public_key);
    set_key(ZMQ_CURVE_SECRETKEY, keys.secret_key);
    watch();
    if (zmq_connect(socket_.get(), hub.c_str()) != 0) {
      throw ConfigError("the address " + hub + " cannot be used: " + zmq_strerror(zmq_errno()));
    }
    descriptors_[0] = {descriptor(socket_.get()), POLLIN, 0};
    descriptors_[1] = {descriptor(monitor_.get()), POLLIN, 0};
  }

  void look() override {
    Part event, address;
    while (zmq_msg_recv(event.get(), monitor_.get(), ZMQ_DONTWAIT) >= 0) {
      std::uint16_t kind = 0;
      std::uint32_t value = 0;
      std::memcpy(&kind, zmq_msg_data(event.get()), sizeof kind);
      std::memcpy(&value, static_cast<char*>(zmq_msg_data(event.get())) + sizeof kind, sizeof value);
      zmq_msg_recv(address.get(), monitor_.get(), 0);
      note(kind, value);
    }
  }

  /// libzmq itself gives up a connection that is silent.
  bool receive(Frames& frames, Milliseconds time, Milliseconds) override {
    const auto deadline = std::chrono::steady_clock::now() + time;
    while (true) {
      if (zmq_msg_recv(part_.get(), socket_.get(), ZMQ_DONTWAIT) >= 0) {
        receive_rest(frames);
        return true;
      }
      const auto before = connections_;
      const bool was = connected_;
      look();
      if (connections_ != before || connected_ != was) return false;
      const auto left = std::chrono::duration_cast<Milliseconds>(deadline - std::chrono::steady_clock::now());
      if (left.count() <= 0) return false;
      ::poll(descriptors_, 2, static_cast<int>(left.count()));
    }
  }

  void send(const Frames& frames) override {
    look();
    if (!connected_) return;
    send(frames.header, frames.has_body ? ZMQ_SNDMORE : 0);
    if (frames.has_body) send(frames.body, 0);
  }

  void leave() noexcept override {
    zmq_disconnect(socket_.get(), hub_.c_str());
    connected_ = false;
  }

 private:
  struct CloseSocket {
    void operator()(void* socket) const { zmq_close(socket); }
  };
  struct EndContext {
    void operator()(void* context) const { zmq_ctx_term(context); }
  };

  /// A frame, which libzmq owns.
  class Part {
   public:
    Part() noexcept { zmq_msg_init(&message_); }
    Part(const Part&) = delete;
    Part& operator=(const Part&) = delete;
    ~Part() { zmq_msg_close(&message_); }

    zmq_msg_t* get() noexcept { return &message_; }
    std::string_view view() noexcept { return {static_cast<char*>(zmq_msg_data(&message_)), zmq_msg_size(&message_)}; }
    bool more() noexcept { return zmq_msg_more(&message_) != 0; }

   private:
    zmq_msg_t message_;
  };

  static constexpr int kEvents = ZMQ_EVENT_HANDSHAKE_SUCCEEDED | ZMQ_EVENT_DISCONNECTED |
                                 ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL | ZMQ_EVENT_HANDSHAKE_FAILED_AUTH;

  void set(int option, int value) { zmq_setsockopt(socket_.get(), option, &value, sizeof value); }

  void set_key(int option, const std::string& key) {
    if (zmq_setsockopt(socket_.get(), option, key.c_str(), key.size() + 1) != 0) {
      throw ConfigError("a key is 40 characters of Z85, and libzmq has to be built with CURVE: " +
                        std::string(zmq_strerror(zmq_errno())));
    }
  }

  void watch() {
    const std::string address = "inproc://glue-rl-monitor";
    monitor_.reset(zmq_socket(context_.get(), ZMQ_PAIR));
    zmq_socket_monitor(socket_.get(), address.c_str(), kEvents);
    zmq_connect(monitor_.get(), address.c_str());
  }

  static int descriptor(void* socket) {
    int result = -1;
    std::size_t size = sizeof result;
    zmq_getsockopt(socket, ZMQ_FD, &result, &size);
    return result;
  }

  void note(unsigned kind, unsigned value) {
    switch (kind) {
      case ZMQ_EVENT_HANDSHAKE_SUCCEEDED:
        connections_ += 1;
        connected_ = true;
        break;
      case ZMQ_EVENT_HANDSHAKE_FAILED_AUTH:
        throw Refused("the hub at " + hub_ + " does not know this key: ask whoever runs it to allow it");
      case ZMQ_EVENT_HANDSHAKE_FAILED_PROTOCOL:
        if (value == ZMQ_PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH) {
          throw ConfigError("the hub at " + hub_ + " wants no keys: unset GLUE_KEY and GLUE_HUB_KEY");
        }
        connected_ = false;
        break;
      default:
        connected_ = false;
        break;
    }
  }

  void receive_rest(Frames& frames) {
    frames.header = part_.view();
    frames.has_body = part_.more();
    frames.body.clear();
    if (!frames.has_body) return;
    zmq_msg_recv(part_.get(), socket_.get(), 0);  // all frames of a message arrive at once
    frames.body = part_.view();
    if (!part_.more()) return;
    while (zmq_msg_recv(part_.get(), socket_.get(), 0) >= 0 && part_.more()) {
    }
    throw ProtocolError("a message has more than two frames");
  }

  void send(const std::string& frame, int flags) {
    while (zmq_send(socket_.get(), frame.data(), frame.size(), flags) < 0 && zmq_errno() == EINTR) {
    }
  }

  std::string hub_;
  std::unique_ptr<void, EndContext> context_;
  std::unique_ptr<void, CloseSocket> socket_;
  std::unique_ptr<void, CloseSocket> monitor_;
  Part part_;
  pollfd descriptors_[2] = {};
};

}  // namespace glue_rl::detail
