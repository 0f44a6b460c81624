#pragma once

#include <sys/stat.h>

#include <fstream>
#include <sstream>
#include <string>
#include <string_view>

#include "../errors.hpp"

namespace glue_rl::detail {

/// CURVE keys, each 40 characters of Z85.
struct Keys {
  std::string public_key;
  std::string secret_key;
  std::string hub;
};

constexpr std::size_t kKeyCharacters = 40;

/// Returns what stands in quotes behind `item =` in a file that `glue-keys` or `zmq.auth` wrote; else nothing.
inline std::string key_in(const std::string& text, std::string_view item) {
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    const auto start = line.find_first_not_of(" \t");
    if (start == std::string::npos || line.compare(start, item.size(), item) != 0) continue;
    const auto equals = line.find_first_not_of(" \t", start + item.size());
    if (equals == std::string::npos || line[equals] != '=') continue;
    const auto open = line.find_first_of("\"'", equals);
    const auto close = open == std::string::npos ? open : line.find(line[open], open + 1);
    if (close != std::string::npos && close - open - 1 == kKeyCharacters) {
      return line.substr(open + 1, kKeyCharacters);
    }
  }
  return {};
}

inline bool read_file(const std::string& path, std::string& text) {
  std::ifstream file(path);
  if (!file) return false;
  text.resize(65536);
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(file.gcount()));
  return true;
}

/// Reads the keys of a program and its hub; `GLUE_KEY` and `GLUE_HUB_KEY` say where they are.
inline Keys read_keys(const std::string& key, const std::string& hub_key) {
  if (key.empty()) throw ConfigError("GLUE_HUB_KEY needs GLUE_KEY, the file with your secret key: glue-keys new NAME");
  if (hub_key.empty()) throw ConfigError("GLUE_KEY needs GLUE_HUB_KEY: ask whoever runs the hub for its public key");
  std::string text;
  if (!read_file(key, text)) throw ConfigError("GLUE_KEY: " + key + " cannot be read; make it with glue-keys new NAME");
  struct stat status {};
  if (stat(key.c_str(), &status) == 0 && (status.st_mode & 077) != 0) {
    throw ConfigError(key + " holds a secret key, and other users can read it: chmod 600 " + key);
  }
  Keys keys;
  keys.public_key = key_in(text, "public-key");
  keys.secret_key = key_in(text, "secret-key");
  if (keys.public_key.empty() || keys.secret_key.empty()) {
    throw ConfigError("GLUE_KEY: " + key + " holds no public and secret key: it should be a NAME.key_secret of glue-keys");
  }
  if (read_file(hub_key, text)) {
    keys.hub = key_in(text, "public-key");
    if (keys.hub.empty()) keys.hub = text.substr(0, text.find_last_not_of(" \t\r\n") + 1);
  } else {
    keys.hub = hub_key;
  }
  if (keys.hub.size() != kKeyCharacters) {
    throw ConfigError("GLUE_HUB_KEY: \"" + hub_key + "\" is neither a key of 40 characters nor a file with one");
  }
  return keys;
}

}  // namespace glue_rl::detail
