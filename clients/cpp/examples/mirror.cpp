// The mirror, with which glue-conform judges this library: docs/clients.md says what it does.
//
// glue-conform agent -- build/mirror agent          (or environment, experiment)

#include <algorithm>
#include <glue_rl/glue_rl.hpp>
#include <iostream>
#include <numeric>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

using glue_rl::AbstractType;
using glue_rl::AbstractView;
using glue_rl::Action;
using glue_rl::Observation;
using glue_rl::ObservationView;

template <class Ints>
double sum(const Ints& ints) {
  return static_cast<double>(std::accumulate(ints.begin(), ints.end(), std::int64_t{0}));
}

void show(std::int64_t extra, AbstractType& to) { to.chars += std::to_string(extra); }
void show(double extra, AbstractType& to) { to.doubles.push_back(extra); }
void show(const std::string& extra, AbstractType& to) { to.chars += extra; }
void show(const std::vector<std::uint8_t>& extra, AbstractType& to) { to.chars.append(extra.begin(), extra.end()); }
void show(const std::vector<double>& extra, AbstractType& to) {
  to.doubles.insert(to.doubles.end(), extra.begin(), extra.end());
}
void show(const std::vector<std::int64_t>& extra, AbstractType& to) {
  for (std::size_t i = 0; i < extra.size(); ++i) to.chars += (i == 0 ? "" : " ") + std::to_string(extra[i]);
}

// An observation, with what is beside it behind its runs.
AbstractType shown(const Observation& seen) {
  AbstractType all = seen;
  for (std::size_t i = 0; i < seen.mask.size(); ++i) {
    if (seen.mask[i]) all.ints.push_back(static_cast<std::int32_t>(i));
  }
  for (const auto& [name, extra] : seen.extras) {
    all.chars += "\n" + name + "=";
    std::visit([&all](const auto& value) { show(value, all); }, extra);
  }
  return all;
}

class Mirror : public glue_rl::Seedable, public glue_rl::Saveable {
 public:
  void seed(std::uint64_t number) override { seed_ = number; }

  std::string save() override { return std::to_string(count_) + " " + std::to_string(seed_); }

  void load(std::string_view data) override { std::istringstream(std::string(data)) >> count_ >> seed_; }

 protected:
  static std::string answer(std::string_view text) {
    if (text == "fail") throw std::runtime_error("asked to fail");
    return std::string(text);
  }

  AbstractType mirror(AbstractType mirrored, const std::vector<double>& more) const {
    if (mirrored.ints.empty() && mirrored.doubles.empty() && mirrored.chars.empty()) return mirrored;
    const double total = sum(mirrored.ints);
    std::reverse(mirrored.ints.begin(), mirrored.ints.end());
    std::reverse(mirrored.doubles.begin(), mirrored.doubles.end());
    std::reverse(mirrored.chars.begin(), mirrored.chars.end());
    mirrored.ints.push_back(count_);
    mirrored.doubles.push_back(total);
    mirrored.doubles.insert(mirrored.doubles.end(), more.begin(), more.end());
    return mirrored;
  }

  int count_ = 0;

 private:
  std::uint64_t seed_ = 0;
};

class MirrorAgent : public Mirror, public glue_rl::Agent, public glue_rl::Measured, public glue_rl::Paced {
 public:
  void pace(double deadline, double latency) override { told_ = {deadline, latency}; }
  glue_rl::Metrics metrics() override { return {{"count", count_}, {"half the count", count_ / 2.0}}; }
  void init(std::string_view) override { count_ = 0; }
  Action start(const ObservationView& observation) override { return step(0, observation); }
  Action step(double reward, const ObservationView& observation) override {
    count_ += 1;
    std::vector<double> more{reward};
    more.insert(more.end(), told_.begin(), told_.end());
    told_.clear();
    return mirror(shown(Observation(observation)), more);
  }
  void end(double) override { count_ += 1; }
  std::string message(std::string_view text) override { return answer(text); }

 private:
  std::vector<double> told_;
};

class MirrorEnvironment : public Mirror, public glue_rl::Environment {
 public:
  std::string init() override {
    count_ = 0;
    return "a mirror, größer than it is";
  }
  Observation start() override {
    count_ += 1;
    return {{count_}};
  }
  Step step(const AbstractView& action) override {
    count_ += 1;
    const double reward = action.doubles().empty() ? 0 : action.doubles().front();
    const char last = action.chars().empty() ? '\0' : action.chars().back();
    Observation observation = mirror(Action(action), {});
    if (last == '&') {
      for (const std::int32_t value : action.ints()) observation.mask.push_back(value != 0);
      observation.extras = {
          {"count", count_},
          {"half", count_ + 0.5},
          {"text", "größer"},
          {"chars", std::vector<std::uint8_t>(action.chars().begin(), action.chars().end())},
          {"ints", std::vector<std::int64_t>(action.ints().begin(), action.ints().end())},
          {"doubles", action.doubles().to_vector()},
      };
    }
    return {reward, last == '!', observation, last == '?'};
  }
  std::string message(std::string_view text) override { return answer(text); }
};

// What the experiment shows of a verb's values.
Action result(std::vector<std::int32_t> ints, std::vector<double> doubles = {}, std::string chars = {}) {
  doubles.push_back(sum(ints));
  return {std::move(ints), std::move(doubles), std::move(chars)};
}

Action words(std::string text) { return result({}, {}, std::move(text)); }

template <class T>
T joined(T all, const T& some, std::initializer_list<typename T::value_type> more) {
  all.insert(all.end(), some.begin(), some.end());
  all.insert(all.end(), more);
  return all;
}

Action both(const Observation& observation, const Action& action, std::initializer_list<std::int32_t> ints = {},
            std::initializer_list<double> doubles = {}) {
  const AbstractType seen = shown(observation);
  return result(joined(seen.ints, action.ints, ints), joined(seen.doubles, action.doubles, doubles),
                seen.chars + action.chars);
}

// The terminal as a number; 2 for a cut-off.
template <class Step>
std::int32_t terminal(const Step& step) {
  return step.truncated ? 2 : step.terminal;
}

class MirrorExperiment {
 public:
  void run() {
    Action shown({}, {}, "ready");
    while (true) {
      const auto order = glue_.env_step(shown);
      const std::string& chars = order.observation.chars;
      const auto space = std::min(chars.find(' '), chars.size());
      const std::string verb = chars.substr(0, space);
      if (verb == "end") return;
      try {
        shown = carry_out(verb, chars.substr(std::min(space + 1, chars.size())), order);
      } catch (const glue_rl::RequestFailed& error) {
        shown = words("ERROR " + error.code() + " " + error.what());
      }
    }
  }

 private:
  Action carry_out(const std::string& verb, const std::string& argument, const glue_rl::Environment::Step& order) {
    Observation given(order.observation.ints, order.observation.doubles, argument);
    given.mask = order.observation.mask;
    if (verb == "RL_INIT") return words(argument.empty() ? glue_.init() : glue_.init(std::stoull(argument)));
    if (verb == "RL_START") {
      const auto start = glue_.start();
      return both(start.observation, start.action);
    }
    if (verb == "RL_STEP") {
      const auto step = glue_.step();
      return both(step.observation, step.action, {terminal(step)}, {step.reward});
    }
    if (verb == "RL_EPISODE") return result({glue_.episode(std::stoull(argument))});
    if (verb == "RL_RETURN") return result({}, {glue_.episode_return()});
    if (verb == "RL_NUM_STEPS") return words(std::to_string(glue_.num_steps()));
    if (verb == "RL_NUM_EPISODES") return words(std::to_string(glue_.num_episodes()));
    if (verb == "RL_AGENT_MESSAGE") return words(glue_.agent_message(argument));
    if (verb == "RL_ENV_MESSAGE") return words(glue_.env_message(argument));
    if (verb == "RL_ENV_START") return both(glue_.env_start(), {});
    if (verb == "RL_ENV_STEP") {
      const auto step = glue_.env_step(given);
      return both(step.observation, {}, {terminal(step)}, {step.reward});
    }
    if (verb == "RL_AGENT_START") return both({}, glue_.agent_start(given));
    if (verb == "RL_AGENT_STEP") return both({}, glue_.agent_step(order.reward, given));
    if (verb == "RL_AGENT_SAVE") return words(glue_.agent_save());
    if (verb == "RL_AGENT_METRICS") {
      std::vector<double> values;
      std::string names;
      for (const auto& [name, value] : glue_.agent_metrics()) {
        names += (values.empty() ? "" : "\n") + name;
        values.push_back(value);
      }
      return result({}, values, names);
    }
    if (verb == "RL_ENV_SAVE") return words(glue_.env_save());
    if (verb == "notices") return words(std::exchange(notices_, {}));
    if (verb == "RL_CLEANUP") {
      glue_.cleanup();
    } else if (verb == "RL_AGENT_END") {
      glue_.agent_end(order.reward);
    } else if (verb == "RL_AGENT_LOAD") {
      glue_.agent_load(argument);
    } else if (verb == "RL_ENV_LOAD") {
      glue_.env_load(argument);
    } else {
      throw std::invalid_argument("the mirror was ordered to do " + verb + ", which it does not know");
    }
    return words({});
  }

  std::string notices_;
  glue_rl::Experiment glue_{glue_rl::Options("mirror"), [this](auto event, auto role, auto name) {
    notices_ += (notices_.empty() ? "" : "\n") + std::string(event) + " " + std::string(role) + " " + std::string(name);
  }};
};

}  // namespace

int main(int argc, char** argv) {
  const std::string role = argc > 1 ? argv[1] : "";
  try {
    if (role == "agent") {
      MirrorAgent agent;
      std::cout << glue_rl::serve(agent, glue_rl::Options("mirror")) << std::endl;
    } else if (role == "environment") {
      MirrorEnvironment environment;
      std::cout << glue_rl::serve(environment, glue_rl::Options("mirror")) << std::endl;
    } else {
      MirrorExperiment().run();
    }
  } catch (const glue_rl::HubClosed& goodbye) {
    std::cout << goodbye.what() << std::endl;
  } catch (const std::exception& error) {
    std::cout << error.what() << std::endl;
    return 1;
  }
}
