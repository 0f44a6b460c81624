// An environment whose second mask leaves the second int of an action no legal value.
#include <glue_rl/glue_rl.hpp>

struct Nowhere : glue_rl::Environment {
  std::string init() override { return "TASK_SPEC"; }
  glue_rl::Observation start() override { return masked(true); }
  Step step(const glue_rl::ActionView&) override { return {0, false, masked(false)}; }
  static glue_rl::Observation masked(bool somewhere) {
    glue_rl::Observation seen{{0}};
    seen.mask = {false, true, false, somewhere, false};
    return seen;
  }
};

int main() {
  Nowhere nowhere;
  return glue_rl::run(nowhere, glue_rl::Options("nowhere"));
}
