#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "abstract_type.hpp"

namespace glue_rl {

/// Numbers with their names.
using Metrics = std::vector<std::pair<std::string, double>>;

/// An agent: it learns. If it is also `Seedable` or `Saveable`, it offers these capabilities.
class Agent {
 public:
  virtual ~Agent() = default;

  /// Prepares for a task; what was learned before is forgotten.
  virtual void init(std::string_view task_spec) { (void)task_spec; }
  /// Takes the first observation of an episode, returns the first action.
  virtual Action start(const ObservationView& observation) = 0;
  /// Takes the reward of the last action and the observation after it, returns the next action.
  virtual Action step(double reward, const ObservationView& observation) = 0;
  /// Takes the last reward of an episode that has reached its end.
  virtual void end(double reward) { (void)reward; }
  /// Releases what `init` acquired; another `init` may follow.
  virtual void cleanup() {}
  /// Answers a text with a text; may come at any time.
  virtual std::string message(std::string_view text) {
    (void)text;
    return {};
  }
};

/// An environment: the task. If it is also `Seedable` or `Saveable`, it offers these capabilities.
class Environment {
 public:
  /// The outcome of an action.
  struct Step {
    double reward = 0;
    /// Whether the episode is over.
    bool terminal = false;
    Observation observation;
    /// Whether it was only cut off, in a state that is not terminal: the agent is shown the observation, and no end.
    bool truncated = false;
  };

  virtual ~Environment() = default;

  /// Prepares; returns the task spec, which describes observations, actions and rewards.
  virtual std::string init() = 0;
  /// Begins an episode; returns its first observation.
  virtual Observation start() = 0;
  /// Executes an action.
  virtual Step step(const ActionView& action) = 0;
  /// Releases what `init` acquired; another `init` may follow.
  virtual void cleanup() {}
  /// Answers a text with a text; may come at any time.
  virtual std::string message(std::string_view text) {
    (void)text;
    return {};
  }
};

/// An agent or environment whose random choices can be repeated: the capability `seed`.
class Seedable {
 public:
  virtual ~Seedable() = default;

  /// Draws all random choices from this number from now on, 0 to 2^63 - 1; comes before `init`.
  virtual void seed(std::uint64_t number) = 0;
};

/// An agent or environment that can be saved between episodes: the capability `save`.
class Saveable {
 public:
  virtual ~Saveable() = default;

  /// Returns everything that later episodes depend on, as bytes.
  virtual std::string save() = 0;
  /// Goes on from what `save` returned, after `init`; check it, it may come from someone else.
  virtual void load(std::string_view data) = 0;
};

/// An agent with numbers of its own, such as its step size: the capability `metrics`.
class Measured {
 public:
  virtual ~Measured() = default;

  /// Returns each number with its name, of 1 to 64 characters without line breaks; this changes nothing in the agent.
  virtual Metrics metrics() = 0;
};

/// An agent that is told how much time it has, where the environment does not wait for it: the capability `pace`.
class Paced {
 public:
  virtual ~Paced() = default;

  /// Takes, before a `step`, the seconds until the environment's next step, and those that the last answer took.
  virtual void pace(double deadline, double latency) = 0;
};

}  // namespace glue_rl
