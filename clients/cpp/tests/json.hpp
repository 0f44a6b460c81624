#pragma once

#include <cctype>
#include <cstdlib>
#include <map>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

// As much of JSON as vectors.json needs.
struct Json {
  char type = 'n';  // null, true, false, digit (0), text ("), array ([) or object ({)
  std::string text;
  std::vector<Json> items;
  std::map<std::string, Json> members;

  static Json parse(std::string_view text) { return value(text); }

  bool has(const std::string& key) const { return members.count(key) != 0; }
  const Json& operator[](const std::string& key) const { return members.at(key); }
  const Json& operator[](std::size_t i) const { return items.at(i); }
  long number() const { return std::atol(text.c_str()); }

 private:
  static char peek(std::string_view& rest) {
    while (std::isspace(static_cast<unsigned char>(rest.at(0))) || rest[0] == ',' || rest[0] == ':') {
      rest.remove_prefix(1);
    }
    return rest[0];
  }

  static Json value(std::string_view& rest) {
    Json json;
    json.type = peek(rest);
    if (json.type == '"') {
      json.text = string(rest);
    } else if (json.type == '[' || json.type == '{') {
      const bool array = json.type == '[';
      rest.remove_prefix(1);
      while (peek(rest) != (array ? ']' : '}')) {
        if (array) {
          json.items.push_back(value(rest));
        } else {
          std::string key = string(rest);
          json.members[key] = value(rest);
        }
      }
      rest.remove_prefix(1);
    } else {
      while (std::isalnum(static_cast<unsigned char>(rest[0])) || rest[0] == '-') {
        json.text += rest[0];
        rest.remove_prefix(1);
      }
    }
    return json;
  }

  static std::string string(std::string_view& rest) {
    if (peek(rest) != '"') throw std::runtime_error("a text was expected");
    std::string result;
    for (rest.remove_prefix(1); rest.at(0) != '"'; rest.remove_prefix(1)) {
      if (rest[0] != '\\') {
        result += rest[0];
        continue;
      }
      rest.remove_prefix(1);
      const auto escape = std::string_view("bfnrt").find(rest[0]);
      if (rest[0] == 'u') {
        append(result, code_unit(rest));
      } else {
        result += escape == std::string_view::npos ? rest[0] : "\b\f\n\r\t"[escape];
      }
    }
    rest.remove_prefix(1);
    return result;
  }

  static unsigned code_unit(std::string_view& rest) {
    unsigned code = static_cast<unsigned>(std::stoul(std::string(rest.substr(1, 4)), nullptr, 16));
    rest.remove_prefix(4);
    if (code >= 0xd800 && code < 0xdc00) {  // the first half of a pair
      rest.remove_prefix(2);
      code = 0x10000 + ((code - 0xd800) << 10) + code_unit(rest) - 0xdc00;
    }
    return code;
  }

  static void append(std::string& to, unsigned code) {
    const auto put = [&to](unsigned byte) { to += static_cast<char>(byte); };
    if (code < 0x80) {
      put(code);
    } else if (code < 0x800) {
      put(0xc0 | code >> 6);
      put(0x80 | (code & 0x3f));
    } else if (code < 0x10000) {
      put(0xe0 | code >> 12);
      put(0x80 | (code >> 6 & 0x3f));
      put(0x80 | (code & 0x3f));
    } else {
      put(0xf0 | code >> 18);
      put(0x80 | (code >> 12 & 0x3f));
      put(0x80 | (code >> 6 & 0x3f));
      put(0x80 | (code & 0x3f));
    }
  }
};
