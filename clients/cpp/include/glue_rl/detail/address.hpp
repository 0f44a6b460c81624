#pragma once

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <cstring>
#include <string>
#include <vector>

#include "../errors.hpp"

namespace glue_rl::detail {

/// Where a hub listens, as the operating system has it.
struct Address {
  sockaddr_storage storage{};
  socklen_t size = 0;
};

inline std::vector<Address> unix_address(const std::string& path) {
  sockaddr_un address{};
  if (path.size() >= sizeof address.sun_path) {
    throw ConfigError("the path of a Unix socket has at most " + std::to_string(sizeof address.sun_path - 1) +
                      " bytes, and " + path + " has " + std::to_string(path.size()));
  }
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, path.data(), path.size());
  Address result;
  result.size = sizeof address;
  std::memcpy(&result.storage, &address, sizeof address);
  return {result};
}

/// Returns the addresses behind one such as `tcp://127.0.0.1:4097` or `ipc:///tmp/hub`.
///
/// Throws ConfigError: it is none, or its host is unknown.
inline std::vector<Address> addresses_of(const std::string& hub) {
  const std::string ipc = "ipc://", tcp = "tcp://";
  if (hub.compare(0, ipc.size(), ipc) == 0 && hub.size() > ipc.size()) return unix_address(hub.substr(ipc.size()));
  const auto colon = hub.rfind(':');
  const std::string port = colon == std::string::npos ? "" : hub.substr(colon + 1);
  const bool number = !port.empty() && port.size() <= 5 && port.find_first_not_of("0123456789") == std::string::npos;
  if (hub.compare(0, tcp.size(), tcp) != 0 || colon <= tcp.size() || !number || std::stoi(port) < 1 ||
      std::stoi(port) > 65535) {
    throw ConfigError("the address of a hub is like tcp://127.0.0.1:4097 or ipc:///tmp/hub, not \"" + hub + "\"");
  }
  std::string host = hub.substr(tcp.size(), colon - tcp.size());
  if (host.size() > 2 && host.front() == '[') host = host.substr(1, host.size() - 2);
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (getaddrinfo(host.c_str(), port.c_str(), &hints, &found) != 0) throw ConfigError("the host " + host + " is unknown");
  std::vector<Address> addresses;
  for (const addrinfo* each = found; each != nullptr; each = each->ai_next) {
    Address address;
    address.size = each->ai_addrlen;
    std::memcpy(&address.storage, each->ai_addr, each->ai_addrlen);
    addresses.push_back(address);
  }
  freeaddrinfo(found);
  return addresses;
}

}  // namespace glue_rl::detail
