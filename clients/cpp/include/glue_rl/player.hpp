#pragma once

#include <cstddef>
#include <exception>
#include <iostream>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "detail/link.hpp"
#include "detail/mask.hpp"
#include "options.hpp"
#include "roles.hpp"

namespace glue_rl {

namespace detail {

/// The answer to a call, as it is being written to `frames`.
class Answer {
 public:
  /// `sizes` are those of the masks of an environment.
  Answer(Frames& frames, const Message& call, const Link& link, std::vector<std::size_t>& sizes)
      : frames_(frames), call_(call), link_(link), sizes_(sizes) {
    frames.body.clear();
    frames.has_body = false;
    header_.begin(0, call.kind, link.session(), call.seq);
  }

  void text(std::string_view bytes) {
    frames_.body = bytes;
    frames_.has_body = true;
  }

  void action(const AbstractType& value) {
    value.write(frames_.body);
    frames_.has_body = true;
  }

  void task_spec(std::string_view task_spec) {
    sizes_ = mask_sizes(task_spec);
    text(task_spec);
  }

  void observation(const Observation& value) {
    if (const std::string why = mask_fault(value.mask, sizes_); !why.empty()) {
      const char* method = call_.kind == kEnvStart ? "start" : "step";
      throw std::invalid_argument(method + (" returned an observation whose mask does not fit the task spec: " + why));
    }
    value.write(frames_.body);
    frames_.has_body = true;
    link_.cut(frames_.body, true);
  }

  void step(const Environment::Step& step) {
    header_.begin(2, call_.kind, link_.session(), call_.seq).real(step.reward);
    if (step.truncated) {
      header_.integer(kCutOff);
    } else {
      header_.truth(step.terminal);
    }
    observation(step.observation);
  }

  void finish() { frames_.header = header_.bytes(); }

 private:
  Frames& frames_;
  const Message& call_;
  const Link& link_;
  std::vector<std::size_t>& sizes_;
  Packer header_;
};

inline bool call_seedable(Seedable* player, const Message& message) {
  if (player != nullptr) player->seed(message.ints[0]);
  return player != nullptr;
}

inline bool call_save(Saveable* player, Answer& answer) {
  if (player != nullptr) answer.text(player->save());
  return player != nullptr;
}

inline bool call_load(Saveable* player, const Message& message) {
  if (player != nullptr) player->load(message.body);
  return player != nullptr;
}

inline bool call_metrics(Measured* agent, Answer& answer) {
  if (agent == nullptr) return false;
  AbstractType packed;
  for (const auto& [name, value] : agent->metrics()) {
    packed.chars += (packed.doubles.empty() ? "" : "\n") + name;
    packed.doubles.push_back(value);
  }
  answer.action(packed);
  return true;
}

inline Action call_step(Agent& agent, const Message& message) {
  if (message.paced) {
    if (auto* paced = dynamic_cast<Paced*>(&agent)) paced->pace(message.floats[1], message.floats[2]);
  }
  return agent.step(message.floats[0], message.first);
}

/// Carries a call out; returns false if it is not one of an agent's.
inline bool carry_out(Agent& agent, const Message& message, Answer& answer) {
  switch (message.kind) {
    case kAgentInit: agent.init(message.body); return true;
    case kAgentStart: answer.action(agent.start(message.first)); return true;
    case kAgentStep: answer.action(call_step(agent, message)); return true;
    case kAgentEnd: agent.end(message.floats[0]); return true;
    case kAgentCleanup: agent.cleanup(); return true;
    case kAgentMessage: answer.text(agent.message(message.body)); return true;
    case kAgentSeed: return call_seedable(dynamic_cast<Seedable*>(&agent), message);
    case kAgentSave: return call_save(dynamic_cast<Saveable*>(&agent), answer);
    case kAgentLoad: return call_load(dynamic_cast<Saveable*>(&agent), message);
    case kAgentMetrics: return call_metrics(dynamic_cast<Measured*>(&agent), answer);
    default: return false;
  }
}

/// Carries a call out; returns false if it is not one of an environment's.
inline bool carry_out(Environment& environment, const Message& message, Answer& answer) {
  switch (message.kind) {
    case kEnvInit: answer.task_spec(environment.init()); return true;
    case kEnvStart: answer.observation(environment.start()); return true;
    case kEnvStep: answer.step(environment.step(message.first)); return true;
    case kEnvCleanup: environment.cleanup(); return true;
    case kEnvMessage: answer.text(environment.message(message.body)); return true;
    case kEnvSeed: return call_seedable(dynamic_cast<Seedable*>(&environment), message);
    case kEnvSave: return call_save(dynamic_cast<Saveable*>(&environment), answer);
    case kEnvLoad: return call_load(dynamic_cast<Saveable*>(&environment), message);
    default: return false;
  }
}

/// An agent or environment in its session: each call is carried out once, however often it comes.
template <class Role>
class Player {
 public:
  Player(const char* role, Role& player, const Options& options)
      : role_(role), name_(options.name), player_(player), link_(role, options, capabilities_of(player)) {}

  /// Answers the hub's calls until it says goodbye; returns its reason.
  std::string serve() {
    try {
      while (true) {
        if (const auto message = link_.receive(frames_)) take(*message);
      }
    } catch (const HubClosed& goodbye) {
      return goodbye.what();
    } catch (const std::exception& error) {
      link_.close(error.what());
      throw;
    }
  }

 private:
  static std::vector<std::string> capabilities_of(Role& player) {
    std::vector<std::string> capabilities;
    if (dynamic_cast<Saveable*>(&player) != nullptr) capabilities.emplace_back("save");
    if (dynamic_cast<Seedable*>(&player) != nullptr) capabilities.emplace_back("seed");
    if (dynamic_cast<Measured*>(&player) != nullptr) capabilities.emplace_back("metrics");
    if (dynamic_cast<Paced*>(&player) != nullptr) capabilities.emplace_back("pace");
    capabilities.emplace_back("mask");
    if (std::is_same_v<Role, Environment>) capabilities.insert(capabilities.end(), {"extras", "truncate"});
    return capabilities;
  }

  void take(const Message& message) {
    if (message.kind == kWelcome) {
      // The last call is kept: if this very call comes again, it is the same hub, which never had the answer.
      if (!message.truth) last_seq_ = 0;
    } else if (message.kind == kError) {
      link_.log("the hub says: " + std::string(message.texts[1]));
    } else if (message.seq >= last_seq_ && link_.welcomed()) {
      const std::uint64_t seq = message.seq;
      if (seq > last_seq_ && !(frames_ == last_call_)) {
        answer(message);
        std::swap(last_call_, frames_);
      }
      last_seq_ = seq;
      // Over a newer connection the hub asks again.
      if (link_.welcomed()) link_.send(last_answer_);
    }
  }

  /// Carries a call out; what is to be sent is the last answer then.
  void answer(const Message& message) {
    try {
      Answer answer(last_answer_, message, link_, sizes_);
      if (carry_out(player_, message, answer)) {
        link_.check(last_answer_.body.size());
        answer.finish();
        return;
      }
      const std::string text = std::string("this ") + role_ + " does not know kind " + std::to_string(message.kind);
      last_answer_.header = link_.error(message.seq, "unknown-kind", text).bytes();
    } catch (const std::exception& error) {
      raised(message.seq, error.what());
    } catch (...) {
      raised(message.seq, "something that is no std::exception was thrown");
    }
  }

  /// Informs the hub that the player threw what is being handled.
  [[noreturn]] void raised(std::uint64_t seq, const char* what) {
    if (link_.welcomed()) link_.send(link_.error(seq, "exception", what));
    std::throw_with_nested(PlayerThrew(std::string(role_) + " " + name_ + " threw: " + what));
  }

  const char* role_;
  std::string name_;
  Role& player_;
  Link link_;
  std::vector<std::size_t> sizes_;
  Frames frames_;
  std::uint64_t last_seq_ = 0;
  Frames last_call_;
  Frames last_answer_;
};

}  // namespace detail

/// Lets an agent take part in a session until the hub says goodbye, and returns its reason. A hub that is not there yet is
/// waited for; a connection that breaks is made again, and the episode goes on.
///
/// Throws ConfigError, Refused, ProtocolError, or PlayerThrew if a method of the agent threw.
inline std::string serve(Agent& agent, const Options& options) {
  return detail::Player<Agent>("agent", agent, options).serve();
}

/// Lets an environment take part in a session, as `serve` does an agent.
inline std::string serve(Environment& environment, const Options& options) {
  return detail::Player<Environment>("environment", environment, options).serve();
}

/// Serves an agent or environment as the whole of a program: prints the reason of the hub's goodbye, or the error, and
/// returns the exit code.
template <class Role>
int run(Role& player, const Options& options) {
  try {
    std::cout << serve(player, options) << std::endl;
    return 0;
  } catch (const std::exception& error) {
    std::cerr << "Error: " << error.what() << std::endl;
    return 1;
  }
}

}  // namespace glue_rl
