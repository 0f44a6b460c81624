#pragma once

#include <fcntl.h>
#include <poll.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <unistd.h>

#include <cerrno>
#include <functional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "address.hpp"
#include "dealer.hpp"
#include "zmtp.hpp"

namespace glue_rl::detail {

/// A DEALER on a socket of its own, for a hub without keys: one system call to receive a message and one to send it, in the
/// thread that asks. (libzmq hands each message to a thread of its own and back.)
class PlainDealer final : public Dealer {
 public:
  using Log = std::function<void(std::string_view)>;

  PlainDealer(const std::string& hub, Log log) : hub_(hub), log_(std::move(log)), addresses_(addresses_of(hub)) {}

  ~PlainDealer() override { drop(); }

  void look() override {}  // connections come and go in `receive` alone

  bool receive(Frames& frames, Milliseconds time, Milliseconds timeout) override {
    if (socket_ < 0 && !connect()) return false;
    while (true) {
      for (auto item = reader_.next(frames); item != FrameReader::Item::kNothing; item = reader_.next(frames)) {
        if (item == FrameReader::Item::kMessage) return true;
        if (take(item)) return false;
      }
      wait_at_most(time);
      const auto [to, most] = reader_.room();
      const auto count = ::recv(socket_, to, most, 0);
      if (count > 0) {
        silent_ = Milliseconds::zero();
        reader_.received(static_cast<std::size_t>(count));
      } else if (count < 0 && errno == EINTR) {
        continue;
      } else if (count < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) {
        silent_ += time;
        if (silent_ >= timeout) drop();
        return false;
      } else {
        drop();
        return false;
      }
    }
  }

  void send(const Frames& frames) override {
    if (!connected_) return;
    const zmtp::Head header(frames.has_body ? zmtp::kMore : 0, frames.header.size());
    const zmtp::Head body(0, frames.body.size());
    iovec parts[] = {part(header.bytes, header.size), part(frames.header.data(), frames.header.size()),
                     part(body.bytes, body.size), part(frames.body.data(), frames.body.size())};
    write(parts, frames.has_body ? 4 : 2);
  }

  void leave() noexcept override {
    if (connected_) {
      // Closed with data unread, a connection would take what was sent along.
      ::shutdown(socket_, SHUT_WR);
      const auto deadline = std::chrono::steady_clock::now() + kLinger;
      char rest[4096];
      for (auto left = kLinger; left.count() > 0;
           left = std::chrono::duration_cast<Milliseconds>(deadline - std::chrono::steady_clock::now())) {
        pollfd reading = {socket_, POLLIN, 0};
        if (::poll(&reading, 1, static_cast<int>(left.count())) <= 0 || ::recv(socket_, rest, sizeof rest, 0) <= 0) break;
      }
    }
    drop();
  }

 private:
  static constexpr Milliseconds kReconnect{100};
  static constexpr Milliseconds kLinger{1000};
  static constexpr int kConnectSeconds = 5;
#ifdef MSG_NOSIGNAL
  static constexpr int kNoSignal = MSG_NOSIGNAL;
#else
  static constexpr int kNoSignal = 0;
#endif

  static iovec part(const char* bytes, std::size_t size) { return {const_cast<char*>(bytes), size}; }

  bool connect() {
    std::this_thread::sleep_until(attempted_ + kReconnect);
    attempted_ = std::chrono::steady_clock::now();
    for (const Address& address : addresses_) {
      socket_ = ::socket(address.storage.ss_family, SOCK_STREAM, 0);
      if (socket_ < 0) continue;
      ::fcntl(socket_, F_SETFD, FD_CLOEXEC);
      const timeval time{kConnectSeconds, 0};  // for connecting, too
      set(SOL_SOCKET, SO_SNDTIMEO, time);
      if (address.storage.ss_family != AF_UNIX) set(IPPROTO_TCP, TCP_NODELAY, 1);
#ifdef SO_NOSIGPIPE
      set(SOL_SOCKET, SO_NOSIGPIPE, 1);
#endif
      if (::connect(socket_, reinterpret_cast<const sockaddr*>(&address.storage), address.size) == 0) break;
      drop();
    }
    if (socket_ < 0) return false;
    reader_ = FrameReader();
    silent_ = waits_ = Milliseconds::zero();
    write(zmtp::greeting());
    return socket_ >= 0;
  }

  template <class T>
  void set(int level, int option, const T& value) {
    ::setsockopt(socket_, level, option, &value, sizeof value);
  }

  void wait_at_most(Milliseconds time) {
    if (time == waits_) return;
    waits_ = time;
    timeval limit{};
    limit.tv_sec = static_cast<decltype(limit.tv_sec)>(time.count() / 1000);
    limit.tv_usec = static_cast<decltype(limit.tv_usec)>(time.count() % 1000 * 1000);
    set(SOL_SOCKET, SO_RCVTIMEO, limit);
  }

  /// Handles anything that is not a message; returns whether a connection was made or lost.
  bool take(FrameReader::Item item) {
    if (item == FrameReader::Item::kGreeting) {
      write(zmtp::ready());
      return socket_ < 0;
    }
    const std::string_view command = reader_.command();
    const std::size_t end = command.empty() ? 0 : std::min<std::size_t>(command.size(), 1 + static_cast<unsigned char>(command[0]));
    const std::string_view name = command.substr(std::min<std::size_t>(1, end), end == 0 ? 0 : end - 1);
    const std::string_view data = command.substr(end);
    if (name == "READY") {
      connected_ = true;
      connections_ += 1;
      return true;
    }
    if (name == "PING") {
      // After two bytes of time to live comes a context that the PONG repeats.
      write(zmtp::command(std::string("\4PONG").append(data.substr(std::min<std::size_t>(2, data.size())))));
    } else if (name == "ERROR") {
      log_("the hub at " + hub_ + " ends the connection: " + std::string(data.substr(std::min<std::size_t>(1, data.size()))));
      drop();
    }
    return socket_ < 0;
  }

  void write(const std::string& bytes) {
    iovec all = part(bytes.data(), bytes.size());
    write(&all, 1);
  }

  void write(iovec* parts, std::size_t count) {
    while (count > 0) {
      msghdr message{};
      message.msg_iov = parts;
      message.msg_iovlen = static_cast<decltype(message.msg_iovlen)>(count);
      const auto sent = ::sendmsg(socket_, &message, kNoSignal);
      if (sent < 0 && errno == EINTR) continue;
      if (sent < 0) return drop();
      auto left = static_cast<std::size_t>(sent);
      for (; count > 0 && left >= parts->iov_len; ++parts, --count) left -= parts->iov_len;
      if (count > 0) *parts = part(static_cast<char*>(parts->iov_base) + left, parts->iov_len - left);
    }
  }

  void drop() noexcept {
    connected_ = false;
    if (socket_ >= 0) ::close(socket_);
    socket_ = -1;
  }

  std::string hub_;
  Log log_;
  std::vector<Address> addresses_;
  int socket_ = -1;
  FrameReader reader_;
  Milliseconds silent_{0};  // waited since anything was received
  Milliseconds waits_{0};   // what the socket waits at most
  std::chrono::steady_clock::time_point attempted_{};  // when a connection was tried last
};

}  // namespace glue_rl::detail
