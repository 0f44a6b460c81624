// An experiment of a few episodes, for whatever agent and environment are there.
//
// With a hub (glue-hub), an agent and an environment: build/experiment [episodes] [seed]

#include <cstdlib>
#include <glue_rl/glue_rl.hpp>
#include <iostream>

int main(int argc, char** argv) {
  constexpr int kMaxSteps = 1000;
  const int episodes = argc > 1 ? std::atoi(argv[1]) : 10;
  const auto seed = argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1;
  try {
    glue_rl::Experiment glue(glue_rl::Options("a few episodes"));
    glue.init(seed);
    for (int done = 0; done < episodes;) {
      try {
        glue.episode(kMaxSteps);
        done += 1;
        const double total = glue.episode_return();
        std::cout << "episode " << done << ": return " << total << ", " << glue.num_steps() << " steps" << std::endl;
      } catch (const glue_rl::PeerLost& error) {
        std::cerr << "again, because " << error.what() << std::endl;
      }
    }
    glue.cleanup();
  } catch (const glue_rl::Error& error) {
    std::cerr << "Error: " << error.what() << std::endl;
    return 1;
  }
}
