// An agent that acts at random within the bounds of the task spec: Infinite Mario, or any task with ints as actions.
//
// glue-experiment --env mario --episodes 10         and, beside it: node random.js

import { serveAgent } from "glue-rl";

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

  start() {
    return this.#act();
  }

  step() {
    return this.#act();
  }

  #act() {
    return { ints: this.#bounds.map(({ low, high }) => low + this.#generator.draw(high - low + 1)) };
  }
}

console.log(await serveAgent(new RandomAgent(), { name: "random" }));
