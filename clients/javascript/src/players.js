// Agents and environments: what the hub can ask them, and how each call is answered exactly once.

import { HubClosed } from "./errors.js";
import { clip, Link } from "./link.js";
import { maskFault, maskSizes } from "./masks.js";
import { AGENT, CUT_OFF, encode, ENV, ERROR } from "./messages.js";

/** @typedef {import("./messages.js").Message} Message */
/** @typedef {{ method: string, otherwise?: any }} Call which method carries a call out; what it brings without one */

/** @type {ReadonlyMap<number, Call>} */
const AGENT_CALLS = new Map([
  [AGENT.INIT, { method: "init" }],
  [AGENT.START, { method: "start" }],
  [AGENT.STEP, { method: "step" }],
  [AGENT.END, { method: "end", otherwise: undefined }],
  [AGENT.CLEANUP, { method: "cleanup", otherwise: undefined }],
  [AGENT.MESSAGE, { method: "message", otherwise: "" }],
  [AGENT.SEED, { method: "seed" }],
  [AGENT.SAVE, { method: "save" }],
  [AGENT.LOAD, { method: "load" }],
  [AGENT.METRICS, { method: "metrics" }],
]);

/** @type {ReadonlyMap<number, Call>} */
const ENVIRONMENT_CALLS = new Map([
  [ENV.INIT, { method: "init" }],
  [ENV.START, { method: "start" }],
  [ENV.STEP, { method: "step" }],
  [ENV.CLEANUP, { method: "cleanup", otherwise: undefined }],
  [ENV.MESSAGE, { method: "message", otherwise: "" }],
  [ENV.SEED, { method: "seed" }],
  [ENV.SAVE, { method: "save" }],
  [ENV.LOAD, { method: "load" }],
]);

/** @param {Readonly<Record<string, number>>} metrics */
const packed = (metrics) => ({
  doubles: Object.values(metrics),
  chars: Buffer.from(Object.keys(metrics).join("\n")),
});

const NEEDED = ["init", "start", "step"];

/** One agent or environment, and its last answer. */
class Player {
  /** @type {Promise<string>} the reason of the hub's goodbye */
  over;
  #player;
  #calls;
  #link;
  /** @type {number | bigint} */
  #lastSeq = 0;
  /** @type {Buffer[]} the frames of the call that was answered last */
  #lastCall = [];
  /** @type {Buffer[]} */
  #lastAnswer = [];
  /** @type {[Message, Buffer[]][]} calls that came while a method that is asynchronous was under way */
  #queue = [];
  #busy = false;
  /** @type {number[]} of the ints of an action */
  #sizes = [];

  /**
   * @param {string} role
   * @param {any} player
   * @param {ReadonlyMap<number, Call>} calls
   * @param {import("./index.js").Options} options
   */
  constructor(role, player, calls, options) {
    for (const method of NEEDED) {
      if (typeof player[method] !== "function") throw new TypeError(`an ${role} needs the method ${method}`);
    }
    this.#player = player;
    this.#calls = calls;
    const capabilities = [];
    if (player.save && player.load) capabilities.push("save");
    if (player.seed) capabilities.push("seed");
    if (player.metrics && calls === AGENT_CALLS) capabilities.push("metrics");
    if (player.pace && calls === AGENT_CALLS) capabilities.push("pace");
    capabilities.push("mask");
    if (calls === ENVIRONMENT_CALLS) capabilities.push("extras", "truncate");
    /** @type {(reason: string) => void} */
    let resolve;
    /** @type {(error: Error) => void} */
    let reject;
    this.over = new Promise((resolved, rejected) => {
      resolve = resolved;
      reject = rejected;
    });
    this.#link = new Link(role, options.name ?? player.constructor?.name ?? role, capabilities, options, {
      // The last call is kept: if this very call comes again, it is the same hub, which never had the answer.
      welcomed: (resumed) => {
        if (!resumed) this.#lastSeq = 0;
      },
      received: (message, frames) => this.#received(message, frames),
      failed: (error) => (error instanceof HubClosed ? resolve(error.message) : reject(error)),
    });
  }

  /** @param {Message} message @param {Buffer[]} frames */
  #received(message, frames) {
    if (message.kind === ERROR) this.#link.log(`the hub says: ${message.scalars[1]}`);
    else if (!this.#link.welcomed) return;
    else if (this.#busy) this.#queue.push([message, frames]);
    else this.#answer(message, frames);
  }

  /** @param {Message} message @param {Buffer[]} frames */
  #answer(message, frames) {
    const { kind, seq, scalars, value } = message;
    if (seq < this.#lastSeq) return;
    if (seq === this.#lastSeq || same(frames, this.#lastCall)) {
      this.#lastSeq = seq;
      this.#link.send(this.#lastAnswer);
      return;
    }
    const call = this.#calls.get(kind);
    const known = call !== undefined && call.method in this.#player;
    if (call === undefined || !(known || "otherwise" in call)) {
      this.#keep(seq, frames, this.#error(seq, "unknown-kind", `this player does not know kind ${kind}`));
      this.#link.send(this.#lastAnswer);
      return;
    }
    const connection = this.#link.greeted;
    try {
      const values = kind === AGENT.SEED || kind === ENV.SEED ? [BigInt(scalars[0])] : scalars;
      if (kind === AGENT.STEP && values.length > 1) this.#player.pace?.(...values.splice(1));
      const result = known ? this.#player[call.method](...values, ...(value === undefined ? [] : [value])) : call.otherwise;
      if (typeof result?.then !== "function") {
        this.#finish(message, frames, result, connection);
        return;
      }
      this.#busy = true;
      result
        .then((/** @type {any} */ awaited) => this.#finish(message, frames, awaited, connection))
        .catch((/** @type {unknown} */ error) => this.#raised(seq, error))
        .finally(() => this.#catchUp());
    } catch (error) {
      this.#raised(seq, error);
    }
  }

  #catchUp() {
    this.#busy = false;
    for (let next; !this.#busy && (next = this.#queue.shift()) !== undefined; ) {
      if (this.#link.welcomed) this.#answer(...next);
    }
  }

  /** @param {Message} message @param {Buffer[]} frames @param {any} result @param {number} connection */
  #finish({ kind, seq }, frames, result, connection) {
    if (kind === ENV.INIT) this.#sizes = maskSizes(result);
    if (kind === ENV.START) this.#check("start", result);
    if (kind === ENV.STEP) this.#check("step", result.observation);
    const answer =
      kind === ENV.STEP
        ? this.#encode(kind, seq, [result.reward, result.truncated ? CUT_OFF : result.terminal], result.observation)
        : this.#encode(kind, seq, [], kind === AGENT.METRICS ? packed(result) : result);
    if (answer.length === 2 && answer[1].length > this.#link.maxBody) {
      throw new RangeError(`the answer has ${answer[1].length} bytes; the hub takes ${this.#link.maxBody}`);
    }
    this.#keep(seq, frames, answer);
    // Over a newer connection the hub asks again.
    if (connection === this.#link.greeted && this.#link.welcomed) this.#link.send(answer);
  }

  /** @param {string} method @param {import("./index.js").ObservationLike} observation */
  #check(method, { mask }) {
    const fault = maskFault(mask ?? [], this.#sizes);
    if (fault) throw new RangeError(`${method} returned an observation whose mask does not fit the task spec: ${fault}`);
  }

  /** @param {number} kind @param {number | bigint} seq @param {any[]} scalars @param {any} value */
  #encode(kind, seq, scalars, value) {
    return encode(kind, this.#link.session, seq, scalars, value, this.#link.takes);
  }

  /** @param {number | bigint} seq @param {Buffer[]} call @param {Buffer[]} answer */
  #keep(seq, call, answer) {
    this.#lastSeq = seq;
    this.#lastCall = call;
    this.#lastAnswer = answer;
  }

  /** @param {number | bigint} seq @param {unknown} error */
  #raised(seq, error) {
    const failure = error instanceof Error ? error : new Error(String(error));
    if (this.#link.welcomed) this.#link.send(this.#error(seq, "exception", failure.message || failure.name));
    this.#link.fail(failure);
  }

  /** @param {number | bigint} seq @param {string} code @param {string} text */
  #error(seq, code, text) {
    return encode(ERROR, this.#link.session, seq, [code, clip(text)]);
  }
}

/** @param {Buffer[]} one @param {Buffer[]} other @returns {boolean} */
function same(one, other) {
  return one.length === other.length && one.every((frame, i) => frame.equals(other[i]));
}

/** @type {typeof import("./index.js").serveAgent} */
export async function serveAgent(agent, options = {}) {
  return new Player("agent", agent, AGENT_CALLS, options).over;
}

/** @type {typeof import("./index.js").serveEnvironment} */
export async function serveEnvironment(environment, options = {}) {
  return new Player("environment", environment, ENVIRONMENT_CALLS, options).over;
}
