#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "detail/link.hpp"
#include "options.hpp"
#include "roles.hpp"

namespace glue_rl {

/// RL-Glue's verbs over a hub. Each waits for the players, and throws PeerLost, PeerFailed, Unsupported, RequestFailed or
/// HubClosed. One thread at a time may use it.
class Experiment {
 public:
  /// What RL_start returns.
  struct Start {
    Observation observation;
    Action action;
  };

  /// What RL_step returns; after a terminal step, `action` is the one that was executed.
  struct Transition {
    double reward = 0;
    /// Whether the episode is over.
    bool terminal = false;
    Observation observation;
    Action action;
    /// Whether the environment cut it off, in a state that is not terminal.
    bool truncated = false;
  };

  /// Receives the event (a player `joined`, was `lost`, has `returned` or is `slow`), the role and the name.
  using Notices = std::function<void(std::string_view event, std::string_view role, std::string_view name)>;

  /// Joins a session as its experiment, once a hub is there.
  explicit Experiment(const Options& options, Notices notices = nullptr)
      : notices_(std::move(notices)), link_("experiment", options, {"mask", "extras"}) {
    while (!link_.welcomed()) receive();
  }

  Experiment(const Experiment&) = delete;
  Experiment& operator=(const Experiment&) = delete;

  /// Says goodbye to the hub, and leaves.
  ~Experiment() {
    try {
      link_.close("the experiment is over");
    } catch (const std::exception&) {
      // The hub has closed already, or is none.
    }
  }

  /// RL_init; returns the task spec. From a seed, 0 to 2^63 - 1, both players are seeded.
  std::string init(std::optional<std::uint64_t> seed = std::nullopt) {
    begin(1, detail::kRlInit);
    return std::string((seed ? ask(header_.integer(*seed)) : ask(header_.nil())).body);
  }

  /// RL_start.
  Start start() {
    const auto reply = ask(begin(0, detail::kRlStart));
    return {Observation(reply.first), Action(reply.second)};
  }

  /// RL_step.
  Transition step() {
    const auto reply = ask(begin(0, detail::kRlStep));
    return {reply.floats[0], reply.truth, Observation(reply.first), Action(reply.second), reply.cut_off};
  }

  /// RL_episode of at most `max_steps` steps, 0 for any number; returns whether it reached its end, and was not cut off.
  bool episode(std::uint64_t max_steps = 0) {
    const auto reply = ask(begin(1, detail::kRlEpisode).integer(max_steps));
    return reply.truth && !reply.cut_off;
  }

  /// RL_return: the sum of the episode's rewards.
  double episode_return() { return ask(begin(0, detail::kRlReturn)).floats[0]; }

  /// RL_num_steps: the number of the episode's steps.
  std::uint64_t num_steps() { return ask(begin(0, detail::kRlNumSteps)).ints[0]; }

  /// RL_num_episodes: the number of episodes that reached their end since the init.
  std::uint64_t num_episodes() { return ask(begin(0, detail::kRlNumEpisodes)).ints[0]; }

  /// RL_agent_message: a text for the agent, and its answer.
  std::string agent_message(std::string_view text) { return with_bytes(detail::kRlAgentMessage, text); }

  /// RL_env_message: a text for the environment, and its answer.
  std::string env_message(std::string_view text) { return with_bytes(detail::kRlEnvMessage, text); }

  /// RL_cleanup.
  void cleanup() { ask(begin(0, detail::kRlCleanup)); }

  /// RL_env_start, for an experiment that stands between the players.
  Observation env_start() { return Observation(ask(begin(0, detail::kRlEnvStart)).first); }

  /// RL_env_step: executes an action.
  Environment::Step env_step(const Action& action) {
    std::string body;
    action.write(body);
    begin(0, detail::kRlEnvStep);
    const auto reply = ask(std::move(body));
    return {reply.floats[0], reply.truth, Observation(reply.first), reply.cut_off};
  }

  /// RL_agent_start: the first observation of an episode for the agent, and its action.
  Action agent_start(const Observation& observation) {
    begin(0, detail::kRlAgentStart);
    return Action(ask(shown(observation)).first);
  }

  /// RL_agent_step: a reward and an observation for the agent, and its action.
  Action agent_step(double reward, const Observation& observation) {
    begin(1, detail::kRlAgentStep).real(reward);
    return Action(ask(shown(observation)).first);
  }

  /// RL_agent_end: the last reward for the agent.
  void agent_end(double reward) { ask(begin(1, detail::kRlAgentEnd).real(reward)); }

  /// Saves the agent.
  std::string agent_save() { return std::string(ask(begin(0, detail::kRlAgentSave)).body); }

  /// Loads the agent from what `agent_save` returned.
  void agent_load(std::string_view data) { with_bytes(detail::kRlAgentLoad, data); }

  /// Returns the agent's own numbers with their names.
  Metrics agent_metrics() {
    const Observation packed(ask(begin(0, detail::kRlAgentMetrics)).first);
    Metrics metrics;
    std::size_t start = 0;
    for (const double value : packed.doubles) {
      const auto end = std::min(packed.chars.find('\n', start), packed.chars.size());
      metrics.emplace_back(packed.chars.substr(start, end - start), value);
      start = std::min(end + 1, packed.chars.size());
    }
    return metrics;
  }

  /// Saves the environment.
  std::string env_save() { return std::string(ask(begin(0, detail::kRlEnvSave)).body); }

  /// Loads the environment from what `env_save` returned.
  void env_load(std::string_view data) { with_bytes(detail::kRlEnvLoad, data); }

 private:
  detail::Packer& begin(std::size_t scalars, detail::Kind kind) {
    kind_ = kind;
    return header_.begin(scalars, kind, link_.session(), seq_ + 1);
  }

  std::string with_bytes(detail::Kind kind, std::string_view bytes) {
    begin(0, kind);
    return std::string(ask(std::string(bytes)).body);
  }

  /// Returns what the agent is to be shown of an observation, as it crosses the wire.
  std::string shown(const Observation& observation) const {
    std::string body;
    observation.write(body);
    link_.cut(body, false);
    return body;
  }

  detail::Message ask(const detail::Packer&) { return ask(detail::Frames()); }

  detail::Message ask(std::string body) {
    link_.check(body.size());
    detail::Frames request;
    request.body = std::move(body);
    request.has_body = true;
    return ask(std::move(request));
  }

  /// Returns the reply to the request whose header was begun, however often the network fails.
  detail::Message ask(detail::Frames request) {
    request.header = header_.bytes();
    seq_ += 1;
    if (link_.welcomed()) link_.send(request);
    while (true) {
      const auto message = receive();
      if (!message) continue;
      if (message->kind == detail::kWelcome) {
        link_.send(request);
      } else if (message->kind == detail::kError) {
        if (message->seq == seq_) fail(std::string(message->texts[0]), std::string(message->texts[1]));
        link_.log("the hub says: " + std::string(message->texts[1]));
      } else if (message->seq == seq_ && message->kind == kind_) {
        answered_ = true;
        return *message;
      }
    }
  }

  /// Returns the next message, having acted on it if it is a WELCOME or a NOTICE.
  std::optional<detail::Message> receive() {
    const auto message = link_.receive(frames_);
    if (!message) return std::nullopt;
    if (message->kind == detail::kNotice) {
      if (notices_) notices_(message->texts[0], message->texts[1], message->texts[2]);
      return std::nullopt;
    }
    if (message->kind == detail::kWelcome && !message->truth && answered_) {
      answered_ = false;
      throw HubClosed("the hub knows nothing of this experiment: it was restarted, or had given it up");
    }
    return message;
  }

  [[noreturn]] void fail(const std::string& code, const std::string& text) {
    answered_ = true;
    if (code == "peer-lost") throw PeerLost(code, text);
    if (code == "peer-failed") throw PeerFailed(code, text);
    if (code == "unsupported") throw Unsupported(code, text);
    throw RequestFailed(code, text);
  }

  Notices notices_;
  detail::Link link_;
  detail::Frames frames_;
  detail::Packer header_;
  detail::Kind kind_ = detail::kRlInit;
  std::uint64_t seq_ = 0;
  bool answered_ = false;  // whether the hub has answered since it last said that it did not know us
};

}  // namespace glue_rl
