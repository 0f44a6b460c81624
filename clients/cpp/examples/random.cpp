// An agent that acts at random within the bounds of the task spec: Infinite Mario, or any task with ints as actions.
// Where the environment says which actions are legal, it chooses among them.
//
// glue-experiment --env mario --episodes 10         and, beside it: build/random

#include <cstdint>
#include <glue_rl/glue_rl.hpp>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

using glue_rl::Action;
using glue_rl::ObservationView;

// Numerical Recipes' linear congruential generator: 32 bits of state, of which the upper 16 are drawn.
class Generator {
 public:
  // Of the seed, the lower 32 bits count.
  explicit Generator(std::uint64_t seed) : state_(static_cast<std::uint32_t>(seed)) {}

  // Returns a number from 0 to n - 1.
  int draw(int n) {
    state_ = state_ * 1664525 + 1013904223;
    return static_cast<int>(state_ >> 16) % n;
  }

 private:
  std::uint32_t state_;
};

struct Bounds {
  int low, high;
};

// Returns the bounds of each int of an action: "ACTIONS INTS (-1 1) (2 0 1)" are three.
std::vector<Bounds> bounds_of(std::string_view task_spec) {
  std::vector<Bounds> bounds;
  const auto actions = task_spec.find("ACTIONS");
  auto at = actions == task_spec.npos ? actions : task_spec.find("INTS", actions);
  if (at == task_spec.npos) return bounds;
  at += 4;
  while ((at = task_spec.find_first_not_of(' ', at)) != task_spec.npos && task_spec[at] == '(') {
    const auto end = task_spec.find(')', at);
    if (end == task_spec.npos) break;
    std::istringstream words(std::string(task_spec.substr(at + 1, end - at - 1)));
    std::vector<int> numbers;
    for (int number; words >> number;) numbers.push_back(number);
    if (numbers.size() == 2) numbers.insert(numbers.begin(), 1);
    if (numbers.size() != 3) break;
    for (int i = 0; i < numbers[0]; ++i) bounds.push_back({numbers[1], numbers[2]});
    at = end + 1;
  }
  return bounds;
}

class RandomAgent : public glue_rl::Agent, public glue_rl::Seedable {
 public:
  void seed(std::uint64_t number) override { generator_ = Generator(number); }
  void init(std::string_view task_spec) override { bounds_ = bounds_of(task_spec); }
  Action start(const ObservationView& observation) override { return act(observation); }
  Action step(double, const ObservationView& observation) override { return act(observation); }

 private:
  Action act(const ObservationView& observation) {
    Action action;
    std::size_t number = 0;  // of a value, among the values of all ints
    for (const auto& [low, high] : bounds_) {
      std::vector<int> legal;
      for (int value = low; value <= high; ++value) {
        if (observation.legal(number++)) legal.push_back(value);
      }
      if (legal.empty()) throw std::runtime_error("an int of the action has no legal value");
      action.ints.push_back(legal[static_cast<std::size_t>(generator_.draw(static_cast<int>(legal.size())))]);
    }
    return action;
  }

  Generator generator_{0};
  std::vector<Bounds> bounds_;
};

}  // namespace

int main() {
  RandomAgent agent;
  return glue_rl::run(agent, glue_rl::Options("random"));
}
