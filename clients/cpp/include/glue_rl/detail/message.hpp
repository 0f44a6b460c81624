#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "../abstract_type.hpp"
#include "msgpack.hpp"

namespace glue_rl::detail {

constexpr std::size_t kMaxHeader = 4096;
constexpr std::size_t kMaxBody = 16777216;
constexpr std::size_t kMaxSession = 255;
constexpr std::uint64_t kCutOff = 2;  // as a terminal

/// The codes of docs/protocol-reference.md, "Every kind of message".
enum Kind : std::uint64_t {
  kAgentInit = 4,
  kAgentStart = 5,
  kAgentStep = 6,
  kAgentEnd = 7,
  kAgentCleanup = 8,
  kAgentMessage = 10,
  kAgentSeed = 80,
  kAgentSave = 81,
  kAgentLoad = 82,
  kAgentMetrics = 86,

  kEnvInit = 11,
  kEnvStart = 12,
  kEnvStep = 13,
  kEnvCleanup = 14,
  kEnvMessage = 19,
  kEnvSeed = 83,
  kEnvSave = 84,
  kEnvLoad = 85,

  kRlInit = 20,
  kRlStart = 21,
  kRlStep = 22,
  kRlCleanup = 23,
  kRlReturn = 24,
  kRlNumSteps = 25,
  kRlNumEpisodes = 26,
  kRlEpisode = 27,
  kRlAgentMessage = 33,
  kRlEnvMessage = 34,
  kRlEnvStart = 36,
  kRlEnvStep = 37,
  kRlAgentStart = 38,
  kRlAgentStep = 39,
  kRlAgentEnd = 40,
  kRlAgentSave = 90,
  kRlAgentLoad = 91,
  kRlEnvSave = 92,
  kRlEnvLoad = 93,
  kRlAgentMetrics = 94,

  kHello = 64,
  kWelcome = 65,
  kRefuse = 66,
  kHeartbeat = 67,
  kGoodbye = 68,
  kError = 69,
  kNotice = 70,
};

/// What a body is; agents are shown observations without extras.
enum class Body { kNone, kBytes, kAction, kSeen, kObservation, kBoth };

/// What a kind carries when it comes from the hub; a scalar is one letter: int, float, bool, text, or Texts, an array that
/// may be missing, or Pace, two floats that may be.
struct Shape {
  const char* scalars;
  Body body;
};

/// Returns the shape of a kind, without scalars (null) if it is not known.
inline Shape from_hub(std::uint64_t kind) {
  switch (kind) {
    case kEnvInit: case kEnvStart: case kEnvCleanup: case kEnvSave: case kAgentCleanup: case kAgentSave:
    case kAgentMetrics: case kRlCleanup: case kRlAgentEnd: case kRlAgentLoad: case kRlEnvLoad: case kHeartbeat:
      return {"", Body::kNone};
    case kAgentInit: case kAgentMessage: case kAgentLoad: case kEnvMessage: case kEnvLoad: case kRlInit:
    case kRlAgentMessage: case kRlEnvMessage: case kRlAgentSave: case kRlEnvSave:
      return {"", Body::kBytes};
    case kEnvStep: case kRlAgentStart: case kRlAgentStep: case kRlAgentMetrics: return {"", Body::kAction};
    case kAgentStart: return {"", Body::kSeen};
    case kAgentStep: return {"fP", Body::kSeen};
    case kRlEnvStart: return {"", Body::kObservation};
    case kRlEnvStep: return {"fb", Body::kObservation};
    case kRlStart: return {"", Body::kBoth};
    case kRlStep: return {"fb", Body::kBoth};
    case kAgentEnd: case kRlReturn: return {"f", Body::kNone};
    case kAgentSeed: case kEnvSeed: case kRlNumSteps: case kRlNumEpisodes: return {"i", Body::kNone};
    case kRlEpisode: return {"b", Body::kNone};
    case kWelcome: return {"ibffiT", Body::kNone};
    case kGoodbye: return {"t", Body::kNone};
    case kRefuse: case kError: return {"tt", Body::kNone};
    case kNotice: return {"ttt", Body::kNone};
    default: return {nullptr, Body::kNone};
  }
}

/// A message from the hub, checked, where it was received. Its scalars are in the order of their types.
struct Message {
  std::uint64_t kind = 0;
  std::string_view session;
  std::uint64_t seq = 0;
  bool known = false;
  std::array<std::uint64_t, 2> ints{};
  std::array<double, 3> floats{};
  bool paced = false;  // whether a step says how much time there is
  bool truth = false;
  bool cut_off = false;  // whether that truth was 2
  std::array<std::string_view, 3> texts{};
  std::vector<std::string_view> capabilities;  // those offered that hold, in a WELCOME
  std::string_view body;
  ObservationView first;  // the observation or action in the body
  AbstractView second;    // the action behind an observation
};

/// Returns what frames from the hub say; `body` is null if there is one frame.
inline Message decode(std::string_view header, const std::string_view* body) {
  if (header.size() > kMaxHeader) {
    throw ProtocolError("a header has at most 4096 bytes, not " + std::to_string(header.size()));
  }
  Unpacker reader(header, "a header");
  Message message;
  const std::uint64_t items = reader.array();
  message.kind = reader.integer();
  message.session = reader.text();
  message.seq = reader.integer();
  if (characters(message.session) > kMaxSession) {
    throw ProtocolError("the name of a session has more than 255 characters");
  }
  const Shape shape = from_hub(message.kind);
  message.known = shape.scalars != nullptr;
  if (!message.known) return message;
  std::size_t ints = 0, floats = 0, texts = 0;
  for (const char* type = shape.scalars; *type != '\0'; ++type) {
    switch (*type) {
      case 'i': message.ints[ints++] = reader.integer(); break;
      case 'f': message.floats[floats++] = reader.real(); break;
      case 'b': {
        const std::uint64_t flag = reader.truth();
        message.truth = flag != 0;
        message.cut_off = flag == kCutOff;
        break;
      }
      case 'T': {
        if (items == static_cast<std::uint64_t>(3 + (type - shape.scalars))) break;
        for (auto left = reader.array(); left != 0; --left) message.capabilities.push_back(reader.text());
        break;
      }
      case 'P': {
        if (items == static_cast<std::uint64_t>(3 + (type - shape.scalars))) break;
        message.paced = true;
        message.floats[1] = reader.real();
        message.floats[2] = reader.real();
        break;
      }
      default: message.texts[texts++] = reader.text(); break;
    }
  }
  reader.end();
  if ((body != nullptr) != (shape.body != Body::kNone)) {
    throw ProtocolError("kind " + std::to_string(message.kind) +
                        (body != nullptr ? " has no body, and came with one" : " has a body, and came without one"));
  }
  if (body == nullptr) return message;
  message.body = *body;
  if (shape.body == Body::kBytes) return message;
  std::string_view rest = *body;
  message.first = shape.body == Body::kAction ? ObservationView(AbstractView::take(rest))
                                              : ObservationView::take(rest, shape.body != Body::kSeen);
  if (shape.body == Body::kBoth) message.second = AbstractView::take(rest);
  if (!rest.empty()) throw ProtocolError("a body is longer than its counts say");
  return message;
}

}  // namespace glue_rl::detail
