// An experiment of a few episodes, for whatever agent and environment are there.
//
// node experiment.js [episodes] [seed]              with a hub (glue-hub), an agent and an environment beside it

import { connect, PeerLost } from "glue-rl";

const [episodes = "10", seed = "1"] = process.argv.slice(2);
const MAX_STEPS = 1000;

const glue = await connect({ name: "a few episodes" });
await glue.init(BigInt(seed));
for (let done = 0; done < Number(episodes); ) {
  try {
    await glue.episode(MAX_STEPS);
    done += 1;
    console.log(`episode ${done}: return ${await glue.episodeReturn()}, ${await glue.numSteps()} steps`);
  } catch (error) {
    if (!(error instanceof PeerLost)) throw error;
    console.error(`again, because ${error.message}`);
  }
}
await glue.cleanup();
await glue.close("all done");
