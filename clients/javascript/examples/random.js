// An agent that acts at random within the bounds of the task spec: Infinite Mario, or any task with ints as actions.
// Where the environment says which actions are legal, it chooses among them.
//
// glue-experiment --env mario --episodes 10         and, beside it: node random.js

import { legal, serveAgent } from "glue-rl";

/** @typedef {import("glue-rl").Observation} Observation */

/** Numerical Recipes' linear congruential generator: 32 bits of state, of which the upper 16 are drawn. */
class Generator {
  #state;

  /** @param {bigint} seed of which the lower 32 bits count */
  constructor(seed) {
    this.#state = Number(seed & 0xffffffffn);
  }

  /** From 0 to n - 1. @param {number} n */
  draw(n) {
    this.#state = (Math.imul(this.#state, 1664525) + 1013904223) >>> 0;
    return (this.#state >>> 16) % n;
  }
}

/** The bounds of each int of an action: "ACTIONS INTS (-1 1) (2 0 1)" are three. @param {string} taskSpec */
function boundsOf(taskSpec) {
  const [, actions = ""] = /\bACTIONS\s+INTS((?:\s*\([^)]*\))*)/.exec(taskSpec) ?? [];
  return [...actions.matchAll(/\(\s*(?:(\d+)\s+)?(-?\d+)\s+(-?\d+)\s*\)/g)].flatMap(([, count = "1", low, high]) =>
    Array.from({ length: Number(count) }, () => ({ low: Number(low), high: Number(high) })),
  );
}

class RandomAgent {
  #generator = new Generator(0n);
  #bounds = boundsOf("");

  /** @param {bigint} seed */
  seed(seed) {
    this.#generator = new Generator(seed);
  }

  /** @param {string} taskSpec */
  init(taskSpec) {
    this.#bounds = boundsOf(taskSpec);
  }

  /** @param {Observation} observation */
  start(observation) {
    return this.#act(observation);
  }

  /** @param {number} reward @param {Observation} observation */
  step(reward, observation) {
    return this.#act(observation);
  }

  /** @param {Observation} observation */
  #act(observation) {
    let number = 0; // of a value, among the values of all ints
    const ints = this.#bounds.map(({ low, high }) => {
      const values = Array.from({ length: high - low + 1 }, (_, i) => low + i).filter(() => legal(observation, number++));
      if (values.length === 0) throw new Error("an int of the action has no legal value");
      return values[this.#generator.draw(values.length)];
    });
    return { ints };
  }
}

console.log(await serveAgent(new RandomAgent(), { name: "random" }));
