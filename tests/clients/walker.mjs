// The agent of docs/examples, with clients/javascript. Usage: node walker.mjs HUB

import { serveAgent } from "../../clients/javascript/src/index.js";

const EMPTY = { ints: [], doubles: [], chars: [] };

// Goes up (1) if its first int says that it is not below its start, else down (0).
class Walker {
  init() {
    this.first = 0;
    this.episodes = 0;
    this.total = 0;
    this.seen = EMPTY;
  }

  start(observation) {
    this.first = observation.ints[0];
    return this.act(observation);
  }

  step(reward, observation) {
    this.total += reward;
    return this.act(observation);
  }

  end(reward) {
    this.total += reward;
    this.episodes += 1;
  }

  act(observation) {
    this.seen = observation;
    return { ints: [observation.ints[0] >= this.first ? 1 : 0] };
  }

  message() {
    const { ints, doubles, chars } = this.seen;
    const sum = doubles.reduce((a, b) => a + b, 0);
    return `${this.episodes} episodes, ${this.total} in all; last seen: ` +
      `${ints.length} ints, ${doubles.length} doubles that sum to ${sum}, ${chars.length} chars`;
  }
}

await serveAgent(new Walker(), { hub: process.argv[2], log: () => {} });
