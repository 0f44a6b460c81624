#pragma once

#include <netdb.h>
#include <poll.h>
#include <zmq.h>

#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "../errors.hpp"
#include "keys.hpp"
#include "message.hpp"

namespace glue_rl::detail {

/// A frame, which libzmq owns.
class Frame {
 public:
  Frame() noexcept { zmq_msg_init(&message_); }
  explicit Frame(std::size_t size) {
    if (zmq_msg_init_size(&message_, size) != 0) throw std::bad_alloc();
  }
  explicit Frame(std::string_view bytes) : Frame(bytes.size()) {
    if (!bytes.empty()) std::memcpy(data(), bytes.data(), bytes.size());
  }
  Frame(Frame&& other) noexcept : Frame() { *this = std::move(other); }
  Frame& operator=(Frame&& other) noexcept {
    zmq_msg_move(&message_, &other.message_);
    return *this;
  }
  Frame(const Frame&) = delete;
  Frame& operator=(const Frame&) = delete;
  ~Frame() { zmq_msg_close(&message_); }

  char* data() noexcept { return static_cast<char*>(zmq_msg_data(&message_)); }
  std::string_view view() const noexcept {
    auto* message = const_cast<zmq_msg_t*>(&message_);
    return {static_cast<const char*>(zmq_msg_data(message)), zmq_msg_size(message)};
  }
  zmq_msg_t* get() noexcept { return &message_; }

 private:
  zmq_msg_t message_;
};

/// The one or two frames of a message.
struct Frames {
  Frame header;
  Frame body;
  bool has_body = false;

  bool operator==(const Frames& other) const {
    return has_body == other.has_body && header.view() == other.header.view() && body.view() == other.body.view();
  }
};

/// A DEALER of libzmq that knows its connections.
class Dealer {
 public:
  Dealer(const std::string& hub, const Keys* keys) : hub_(hub) {
    check_host(hub);
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
    if (keys != nullptr) {
      set_key(ZMQ_CURVE_SERVERKEY, keys->hub);
      set_key(ZMQ_CURVE_PUBLICKEY, keys->public_key);
      set_key(ZMQ_CURVE_SECRETKEY, keys->secret_key);
    }
    watch();
    if (zmq_connect(socket_.get(), hub.c_str()) != 0) {
      throw ConfigError("the address of a hub is like tcp://127.0.0.1:4097 or ipc:///tmp/hub, not \"" + hub + "\"");
    }
    descriptors_[0] = {descriptor(socket_.get()), POLLIN, 0};
    descriptors_[1] = {descriptor(monitor_.get()), POLLIN, 0};
  }

  /// Counts the connections.
  std::uint64_t connections() const noexcept { return connections_; }

  bool connected() const noexcept { return connected_; }

  /// Takes note of connections that came or went; returns whether any did.
  bool look() {
    const auto before = connections_;
    const bool was = connected_;
    Frame event, address;
    while (zmq_msg_recv(event.get(), monitor_.get(), ZMQ_DONTWAIT) >= 0) {
      std::uint16_t kind = 0;
      std::uint32_t value = 0;
      std::memcpy(&kind, event.data(), sizeof kind);
      std::memcpy(&value, event.data() + sizeof kind, sizeof value);
      zmq_msg_recv(address.get(), monitor_.get(), 0);
      note(kind, value);
    }
    return connections_ != before || connected_ != was;
  }

  /// Receives the next message; returns false if there is none within `time`, or a connection came or went.
  bool receive(Frames& frames, std::chrono::milliseconds time) {
    const auto deadline = std::chrono::steady_clock::now() + time;
    while (true) {
      if (zmq_msg_recv(frames.header.get(), socket_.get(), ZMQ_DONTWAIT) >= 0) {
        receive_body(frames);
        return true;
      }
      if (look()) return false;
      const auto left =
          std::chrono::duration_cast<std::chrono::milliseconds>(deadline - std::chrono::steady_clock::now());
      if (left.count() <= 0) return false;
      ::poll(descriptors_, 2, static_cast<int>(left.count()));
    }
  }

  /// Sends a message; the frames are kept. Without a connection nothing is sent: the hub asks again.
  void send(const Frames& frames) {
    if (!connected_) return;
    send(frames.header, frames.has_body ? ZMQ_SNDMORE : 0);
    if (frames.has_body) send(frames.body, 0);
  }

  /// Makes no further connection; what was sent still leaves.
  void leave() noexcept {
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
          throw ConfigError("the hub at " + hub_ + " and this program differ on keys: set GLUE_KEY and GLUE_HUB_KEY " +
                            "for a hub that wants them, and neither for one that does not");
        }
        connected_ = false;
        break;
      default:
        connected_ = false;
        break;
    }
  }

  void receive_body(Frames& frames) {
    frames.has_body = zmq_msg_more(frames.header.get()) != 0;
    if (!frames.has_body) {
      frames.body = Frame();
      return;
    }
    zmq_msg_recv(frames.body.get(), socket_.get(), 0);  // all frames of a message arrive at once
    if (zmq_msg_more(frames.body.get()) == 0) return;
    for (Frame more; zmq_msg_recv(more.get(), socket_.get(), 0) >= 0 && zmq_msg_more(more.get()) != 0;) {
    }
    throw ProtocolError("a message has more than two frames");
  }

  void send(const Frame& frame, int flags) {
    Frame copy;  // of a large frame, libzmq shares the bytes
    zmq_msg_copy(copy.get(), const_cast<Frame&>(frame).get());
    while (zmq_msg_send(copy.get(), socket_.get(), flags) < 0 && zmq_errno() == EINTR) {
    }
  }

  static void check_host(const std::string& hub) {
    const std::string tcp = "tcp://";
    const auto colon = hub.rfind(':');
    if (hub.compare(0, tcp.size(), tcp) != 0 || colon < tcp.size()) return;
    std::string host = hub.substr(tcp.size(), colon - tcp.size());
    if (host.size() > 2 && host.front() == '[') host = host.substr(1, host.size() - 2);
    addrinfo* found = nullptr;
    if (getaddrinfo(host.c_str(), nullptr, nullptr, &found) != 0) throw ConfigError("the host " + host + " is unknown");
    freeaddrinfo(found);
  }

  std::string hub_;
  std::unique_ptr<void, EndContext> context_;
  std::unique_ptr<void, CloseSocket> socket_;
  std::unique_ptr<void, CloseSocket> monitor_;
  pollfd descriptors_[2] = {};
  std::uint64_t connections_ = 0;
  bool connected_ = false;
};

}  // namespace glue_rl::detail
