// RL-Glue's skeleton environment, a walk along 21 states, from the middle to either end.
//
// glue-experiment --agent random --episodes 10      and, beside it: node skeleton.js

import { serveEnvironment } from "glue-rl";

const FIRST = 10;
const LAST = 20;

/** Action 0 goes down, 1 goes up; state 0 ends with the reward -1, state 20 with +1. */
class Walk {
  #state = FIRST;

  init() {
    return (
      "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 " +
      "OBSERVATIONS INTS (0 20) ACTIONS INTS (0 1) REWARDS (-1.0 1.0) EXTRA skeleton"
    );
  }

  start() {
    this.#state = FIRST;
    return { ints: [this.#state] };
  }

  /** @param {import("glue-rl").Action} action */
  step({ ints: [action] }) {
    this.#state += action === 1 ? 1 : -1;
    const reward = this.#state === LAST ? 1 : this.#state === 0 ? -1 : 0;
    return { reward, terminal: reward !== 0, observation: { ints: [this.#state] } };
  }

  message() {
    return "I don't know how to respond to your message";
  }
}

console.log(await serveEnvironment(new Walk(), { name: "skeleton" }));
