// The codec against glue/testing/vectors.json, which docs/clients.md describes. Usage: vectors_test vectors.json

#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <glue_rl/glue_rl.hpp>
#include <iomanip>
#include <iostream>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "json.hpp"

namespace {

using glue_rl::Observation;
using glue_rl::detail::Packer;
using glue_rl::detail::Message;

const std::set<std::string> kRoles = {"peer", "agent", "environment", "experiment"};

int checked = 0;
std::string current;

void expect(bool right, const char* what) {
  checked += 1;
  if (right) return;
  std::cerr << "wrong " << what << " in: " << current << std::endl;
  std::exit(1);
}

std::string bytes(const std::string& hex) {
  std::string result;
  for (std::size_t i = 0; i < hex.size(); i += 2) {
    result += static_cast<char>(std::stoi(hex.substr(i, 2), nullptr, 16));
  }
  return result;
}

std::uint64_t bits_of(double value) {
  std::uint64_t bits;
  std::memcpy(&bits, &value, sizeof bits);
  return bits;
}

std::uint64_t bits_of(const Json& hex) { return std::stoull(hex.text, nullptr, 16); }

double real(const Json& hex) {
  const std::uint64_t bits = bits_of(hex);
  double value;
  std::memcpy(&value, &bits, sizeof value);
  return value;
}

Observation observation(const Json& one) {
  Observation result;
  for (const Json& value : one["ints"].items) result.ints.push_back(static_cast<std::int32_t>(value.number()));
  for (const Json& value : one["doubles"].items) result.doubles.push_back(real(value));
  result.chars = bytes(one["chars"].text);
  if (one.has("mask")) {
    for (const char byte : bytes(one["mask"].text)) {
      for (int i = 0; i < 8; ++i) result.mask.push_back((byte >> i & 1) != 0);
    }
  }
  if (one.has("extras")) result.extras = glue_rl::detail::unpack(bytes(one["extras"].text));
  return result;
}

std::string body_of(const Json& body) {
  if (body.has("text")) return body["text"].text;
  if (body.has("bytes")) return bytes(body["bytes"].text);
  std::string result;
  for (const Json& one : body["abstract"].items) {
    std::string written;
    observation(one).write(written);
    result += written;
  }
  return result;
}

void write(Packer& header, const Json& scalar) {
  const auto& [type, value] = *scalar.members.begin();
  if (type == "int") header.integer(std::stoull(value.text));
  if (type == "float") header.real(real(value));
  if (type == "bool") header.truth(value.type == 't');
  if (type == "text") header.text(value.text);
  if (type == "binary") header.binary(bytes(value.text));
  if (type == "nil") header.nil();
  if (type == "array") {
    header.array(value.items.size());
    for (const Json& item : value.items) write(header, item);
  }
}

Message decode(const std::vector<std::string>& frames) {
  const std::string_view body = frames.size() > 1 ? std::string_view(frames[1]) : std::string_view();
  return glue_rl::detail::decode(frames[0], frames.size() > 1 ? &body : nullptr);
}

std::vector<std::string> frames_of(const Json& entry) {
  std::vector<std::string> frames;
  for (const Json& frame : entry["frames"].items) frames.push_back(bytes(frame.text));
  return frames;
}

/// Returns the frames, or the command, that come of bytes behind a greeting, which are received one at a time.
std::vector<std::string> read(const std::string& hex) {
  glue_rl::detail::FrameReader reader;
  glue_rl::detail::Frames frames;
  std::vector<std::string> result;
  for (const char byte : glue_rl::detail::zmtp::greeting() + bytes(hex)) {
    *reader.room().first = byte;
    reader.received(1);
    using Item = glue_rl::detail::FrameReader::Item;
    for (Item item = reader.next(frames); item != Item::kNothing; item = reader.next(frames)) {
      if (item == Item::kCommand) result.emplace_back(reader.command());
      if (item != Item::kMessage) continue;
      result.push_back(frames.header);
      if (frames.has_body) result.push_back(frames.body);
    }
  }
  return result;
}

/// Returns frames in hex, as ZMTP carries them.
std::string wire_of(const std::vector<std::string>& frames) {
  std::ostringstream hex;
  hex << std::hex << std::setfill('0');
  for (std::size_t i = 0; i < frames.size(); ++i) {
    hex << (i + 1 < frames.size() ? "01" : "00") << std::setw(2) << frames[i].size();
    for (const char byte : frames[i]) hex << std::setw(2) << static_cast<unsigned>(static_cast<unsigned char>(byte));
  }
  return hex.str();
}

template <class Action>
void refuses(Action action) {
  try {
    action();
  } catch (const glue_rl::ProtocolError&) {
    checked += 1;
    return;
  }
  expect(false, "acceptance");
}

bool same(const Observation& read, const Json& one) {
  std::string read_body, expected_body;
  read.write(read_body);
  observation(one).write(expected_body);
  return read_body == expected_body;
}

void check_decoded(const Json& entry, bool cut_off) {
  const auto frames = frames_of(entry);
  const Message message = decode(frames);
  expect(message.known && message.kind == static_cast<std::uint64_t>(entry["code"].number()), "kind");
  expect(message.session == entry["session"].text, "session");
  expect(message.seq == std::stoull(entry["seq"].text), "seq");
  std::size_t ints = 0, floats = 0, texts = 0;
  for (const Json& scalar : entry["scalars"].items) {
    const auto& [type, value] = *scalar.members.begin();
    if (type == "int" && cut_off) expect(message.truth && message.cut_off, "terminal");
    if (type == "int" && !cut_off) expect(message.ints[ints++] == std::stoull(value.text), "int");
    if (type == "float") expect(bits_of(message.floats[floats++]) == bits_of(value), "float");
    if (type == "bool") expect(message.truth == (value.type == 't') && !message.cut_off, "bool");
    if (type == "text") expect(message.texts[texts++] == value.text, "text");
    if (type != "array") continue;
    expect(message.capabilities.size() == value.items.size(), "number of capabilities");
    for (std::size_t i = 0; i < value.items.size(); ++i) {
      expect(message.capabilities[i] == value.items[i]["text"].text, "capability");
    }
  }
  if (entry["body"].type != '{') return;
  if (!entry["body"].has("abstract")) {
    expect(message.body == body_of(entry["body"]), "body");
    return;
  }
  const auto& values = entry["body"]["abstract"].items;
  expect(same(Observation(message.first), values[0]), "observation or action");
  if (values.size() == 2) expect(same(Observation(message.second), values[1]), "action");
}

/// Returns a body as this library writes it, with the extras in the order of their names.
std::string rewritten(const Json& body, const std::string& received) {
  if (!body.has("abstract")) return received;
  std::string_view rest = received;
  std::string written;
  Observation(glue_rl::ObservationView::take(rest, true)).write(written);
  return written + std::string(rest);
}

void check_encoded(const Json& entry) {
  Packer header;
  const auto& scalars = entry["scalars"].items;
  header.begin(scalars.size(), static_cast<std::uint64_t>(entry["code"].number()), entry["session"].text,
               std::stoull(entry["seq"].text));
  for (const Json& scalar : scalars) write(header, scalar);
  const auto frames = frames_of(entry);
  expect(header.bytes() == frames[0], "header");
  if (frames.size() > 1) expect(body_of(entry["body"]) == rewritten(entry["body"], frames[1]), "body");
}

glue_rl::Extra extra(const Json& scalar) {
  const auto& [type, value] = *scalar.members.begin();
  if (type == "int") return std::int64_t{std::stoll(value.text)};
  if (type == "float") return real(value);
  if (type == "text") return value.text;
  if (type == "binary") {
    const std::string read = bytes(value.text);
    return std::vector<std::uint8_t>(read.begin(), read.end());
  }
  if (!value.items.empty() && value[0].has("float")) {
    std::vector<double> numbers;
    for (const Json& item : value.items) numbers.push_back(real(item["float"]));
    return numbers;
  }
  std::vector<std::int64_t> numbers;
  for (const Json& item : value.items) numbers.push_back(std::stoll(item["int"].text));
  return numbers;
}

void check_extras(const Json& extras) {
  for (const Json& entry : extras["accepted"].items) {
    current = entry["name"].text;
    glue_rl::Extras values;
    for (const auto& [name, value] : entry["values"].members) values.emplace(name, extra(value));
    expect(glue_rl::detail::unpack(bytes(entry["hex"].text)) == values, "extras");
    if (!values.empty()) expect(glue_rl::detail::unpack(glue_rl::detail::pack(values)) == values, "packed extras");
  }
  for (const Json& entry : extras["refused"].items) {
    current = entry["name"].text;
    refuses([&] { glue_rl::detail::unpack(bytes(entry["hex"].text)); });
  }
}

void check_what_is_not_sent() {
  current = "what nobody would read";
  std::vector<Observation> all(7);
  all[0].extras = {{"", 1}};
  all[1].extras = {{"a\nb", 1}};
  all[2].extras = {{std::string(65, 'a'), 1}};
  all[3].extras = {{"large", std::vector<std::uint8_t>(65535)}};
  all[4].extras = {{"huge", std::vector<double>(70000)}};
  for (int i = 0; i < 65; ++i) all[5].extras[std::to_string(i)] = i;
  all[6].mask.resize(8 * 65535 + 1);
  for (const Observation& observation : all) {
    std::string body;
    try {
      observation.write(body);
    } catch (const std::invalid_argument&) {
      checked += 1;
      continue;
    }
    expect(false, "acceptance");
  }
}

void check_legal() {
  current = "an observation with a mask";
  Observation observation{{7}};
  observation.mask = {false, true, true};
  std::string body;
  observation.write(body);
  std::string_view rest = body;
  const auto view = glue_rl::ObservationView::take(rest, false);
  expect(!view.legal(0) && view.legal(1) && view.legal(2) && !view.legal(3) && !view.legal(8), "mask");
  expect(glue_rl::ObservationView().legal(9), "lack of a mask");

  using glue_rl::detail::mask_fault;
  using glue_rl::detail::mask_sizes;
  const auto sizes = mask_sizes("OBSERVATIONS INTS (0 9) Actions DOUBLES (0 1) ints (0 1)( 2 -1 1 ) CHARCOUNT 2 REWARDS (0 1)");
  expect(sizes == std::vector<std::size_t>{2, 3, 3}, "sizes");
  expect(mask_sizes("ACTIONS INTS (0 UNSPEC) REWARDS").empty() && mask_sizes("a mirror").empty(), "unknown sizes");
  expect(mask_sizes("ACTIONS INTS (2 -4611686018427387904 4611686018427387903) (0 7)").empty(), "sizes that overflow");
  expect(mask_sizes("ACTIONS INTS (9223372036854775807 0 1) (9223372036854775807 0 1)").empty(), "a count that overflows");
  expect(mask_sizes("ACTIONS DOUBLES (0 1) REWARDS (0 1) EXTRA INTS (0 1)").empty(), "no ints");
  expect(mask_fault({0, 1, 0, 0, 1, 1, 0, 0}, sizes).empty() && mask_fault({}, sizes).empty(), "masks that fit");
  expect(mask_fault({0, 1, 0, 0, 0, 1, 0, 0}, sizes) == "no value of int 1 is legal", "an empty int");
  expect(!mask_fault({1, 1, 1, 1, 1, 1, 1, 1, 1}, sizes).empty(), "a long mask");
  expect(mask_fault({1, 1, 1, 1, 1, 1, 1}, sizes) == "it is of 7 values, and the ints of an action have 8", "a short mask");
  expect(!mask_fault({1, 0, 1, 0, 1}, {2, 2}).empty() && mask_fault({0}, {}).empty(), "one value more");
}

void check_refused(const Json& entry) {
  const auto frames = frames_of(entry);
  refuses([&] { frames.size() > 2 ? read(wire_of(frames)) : (decode(frames), frames); });
}

void check_zmtp(const Json& zmtp) {
  namespace ours = glue_rl::detail::zmtp;
  current = "ZMTP";
  expect(ours::greeting() == bytes(zmtp["greeting"].text), "greeting");
  expect(ours::ready() == bytes(zmtp["ready"].text), "READY");
  const auto ping = zmtp["ping with a context"].text;
  expect(read(ping) == std::vector<std::string>{bytes(ping).substr(2)}, "PING");
  for (const Json& entry : zmtp["refused"].items) {
    current = entry["name"].text;
    if (current != "the command ERROR") refuses([&] { read(entry["hex"].text); });
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  std::ostringstream text;
  text << std::ifstream(argv[1]).rdbuf();
  const Json vectors = Json::parse(text.str());
  for (const std::string section : {"messages", "accepted", "truncate", "beside", "pace"}) {
    for (const Json& entry : vectors[section].items) {
      current = entry["kind"].text + ", " + entry["name"].text;
      const std::string &from = entry["from"].text, &to = entry["to"].text;
      if (kRoles.count(from) + kRoles.count(to) == 0) continue;  // this library has no such role
      if (from == "hub") {
        check_decoded(entry, section == "truncate");
        expect(read(entry["wire"].text) == frames_of(entry), "frames");
      } else {
        check_encoded(entry);
      }
    }
  }
  for (const Json& entry : vectors["refused"].items) {
    current = entry["name"].text;
    check_refused(entry);
  }
  check_extras(vectors["extras"]);
  check_what_is_not_sent();
  check_legal();
  check_zmtp(vectors["zmtp"]);
  std::cout << checked << " checks passed" << std::endl;
}
