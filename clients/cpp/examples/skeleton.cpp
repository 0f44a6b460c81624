// RL-Glue's skeleton environment, a walk along 21 states, from the middle to either end.
//
// glue-experiment --agent random --episodes 10      and, beside it: build/skeleton

#include <glue_rl/glue_rl.hpp>
#include <stdexcept>
#include <string>

namespace {

constexpr int kFirst = 10;
constexpr int kLast = 20;

// Action 0 goes down, 1 goes up; state 0 ends with the reward -1, state 20 with +1.
class Walk : public glue_rl::Environment {
 public:
  std::string init() override {
    return "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 "
           "OBSERVATIONS INTS (0 20) ACTIONS INTS (0 1) REWARDS (-1.0 1.0) EXTRA skeleton";
  }

  glue_rl::Observation start() override {
    state_ = kFirst;
    return {{state_}};
  }

  Step step(const glue_rl::ActionView& action) override {
    if (action.ints().empty()) throw std::invalid_argument("an action is one int");
    state_ += action.ints()[0] == 1 ? 1 : -1;
    const double reward = state_ == kLast ? 1 : state_ == 0 ? -1 : 0;
    return {reward, reward != 0, {{state_}}};
  }

  std::string message(std::string_view) override { return "I don't know how to respond to your message"; }

 private:
  int state_ = kFirst;
};

}  // namespace

int main() {
  Walk walk;
  return glue_rl::run(walk, glue_rl::Options("skeleton"));
}
