#pragma once

#include <cstdlib>
#include <functional>
#include <iostream>
#include <string>
#include <string_view>

namespace glue_rl {

/// The value of an environment variable, or `otherwise` if it is not set or empty.
inline std::string environment_variable(const char* name, std::string otherwise) {
  const char* value = std::getenv(name);
  return value == nullptr || *value == '\0' ? std::move(otherwise) : std::string(value);
}

/// The hub and the session that a program joins, and its name.
struct Options {
  explicit Options(std::string a_name) : name(std::move(a_name)) {}

  /// What people see.
  std::string name;
  /// The hub's address, such as `tcp://127.0.0.1:4097` or `ipc:///tmp/hub`.
  std::string hub = environment_variable("GLUE_HUB", "tcp://127.0.0.1:4097");
  /// The session's name: 1 to 255 printable characters.
  std::string session = environment_variable("GLUE_SESSION", "default");
  /// The file with this program's own keys (NAME.key_secret of `glue-keys new NAME`); empty for a hub without keys.
  std::string key = environment_variable("GLUE_KEY", "");
  /// The hub's public key, or a file that holds it.
  std::string hub_key = environment_variable("GLUE_HUB_KEY", "");
  /// Receives lines for people.
  std::function<void(std::string_view)> log = [](std::string_view line) { std::cerr << line << std::endl; };
};

}  // namespace glue_rl
