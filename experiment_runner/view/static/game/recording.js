// A recorded episode in the server's format: see experiment_runner/view/episodes.py.

import { decode, endOf } from "./values.js";

const ENDINGS = { terminal: "terminal", cutoff: "cut off", void: "void: it does not count" };

export class Recording {
  constructor(buffer) {
    const view = new DataView(buffer);
    const size = view.getUint32(0, true);
    this.about = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
    this.length = this.about.steps + 1; // including the start
    this.rewards = new Float64Array(this.length);
    this.returns = new Float64Array(this.length);
    this._view = view;
    this._starts = new Uint32Array(this.length);
    let at = 4 + size;
    let total = 0;
    for (let i = 0; i < this.length; i++) {
      this._starts[i] = at;
      this.rewards[i] = view.getFloat64(at, true);
      this.returns[i] = total += this.rewards[i];
      at = endOf(view, endOf(view, at + 8));
    }
    this._answered = this.about.answers ?? []; // [step, message, answer], in order of steps
    if (at !== buffer.byteLength) throw new Error("The recording did not arrive whole.");
  }

  /** Return the agent's answers up to a step, as pairs of message and answer. */
  answers(step) {
    const found = new Map();
    for (const [at, message, answer] of this._answered) {
      if (at > step) break;
      found.set(message, answer);
    }
    return [...found];
  }

  /** Return a moment: step 0 is the start, which has no action. */
  moment(step) {
    const action = decode(this._view, this._starts[step] + 8);
    return {
      step,
      action: step ? action : null,
      observation: decode(this._view, action.end),
      reward: this.rewards[step],
      total: this.returns[step],
      answers: this.answers(step),
      ending: step === this.length - 1 ? ENDINGS[this.about.ending] ?? "" : "",
    };
  }
}
