// An experiment: it keeps the request that is not answered, and repeats it over each new connection.

import { GlueError, HubClosed, PeerFailed, PeerLost, ProtocolError, Unsupported } from "./errors.js";
import { Link } from "./link.js";
import { CUT_OFF, encode, ERROR, NOTICE, RL } from "./messages.js";

/** @typedef {import("./messages.js").Message} Message */

/** @type {Readonly<Record<string, typeof GlueError>>} */
const ERRORS = { "peer-lost": PeerLost, "peer-failed": PeerFailed, unsupported: Unsupported };

/** @implements {Pick<import("./index.js").Experiment, keyof import("./index.js").Experiment>} */
export class Experiment {
  #link;
  #onNotice;
  #seq = 0;
  #answered = false; // whether the hub has answered a request since it last said that it did not know us
  /** @type {{ seq: number, kind: number, frames: Buffer[], resolve: (reply: Message) => void, reject: (error: Error) => void } | null} */
  #pending = null;
  /** @type {Error | null} why no request can be answered any more */
  #over = null;
  /** @type {Error | null} what the next request has to be told first */
  #forgotten = null;
  /** @type {Promise<void>} */
  joined;

  /** @param {import("./index.js").ExperimentOptions} options */
  constructor(options) {
    this.#onNotice = options.onNotice;
    /** @type {() => void} */
    let join = () => {};
    /** @type {(error: Error) => void} */
    let refuse = () => {};
    this.joined = new Promise((resolve, reject) => {
      join = resolve;
      refuse = reject;
    });
    this.#link = new Link("experiment", options.name ?? "experiment", ["mask", "extras"], options, {
      welcomed: (resumed) => {
        this.#welcomed(resumed);
        join();
      },
      received: (message) => this.#received(message),
      failed: (error) => {
        this.#over = error;
        refuse(error);
        this.#fail(error);
      },
    });
  }

  async init(/** @type {number | bigint | undefined} */ seed = undefined) {
    return (await this.#ask(RL.INIT, [seed])).value;
  }

  async start() {
    const [observation, action] = (await this.#ask(RL.START)).value;
    return { observation, action };
  }

  async step() {
    const { scalars: [reward, terminal], value: [observation, action] } = await this.#ask(RL.STEP);
    return { reward, terminal: terminal !== false, observation, truncated: terminal === CUT_OFF, action };
  }

  async episode(/** @type {number | bigint} */ maxSteps = 0) {
    return (await this.#ask(RL.EPISODE, [maxSteps])).scalars[0] === true;
  }

  async episodeReturn() {
    return (await this.#ask(RL.RETURN)).scalars[0];
  }

  async numSteps() {
    return BigInt((await this.#ask(RL.NUM_STEPS)).scalars[0]);
  }

  async numEpisodes() {
    return BigInt((await this.#ask(RL.NUM_EPISODES)).scalars[0]);
  }

  async agentMessage(/** @type {string} */ text) {
    return (await this.#ask(RL.AGENT_MESSAGE, [], text)).value;
  }

  async envMessage(/** @type {string} */ text) {
    return (await this.#ask(RL.ENV_MESSAGE, [], text)).value;
  }

  async cleanup() {
    await this.#ask(RL.CLEANUP);
  }

  async envStart() {
    return (await this.#ask(RL.ENV_START)).value;
  }

  async envStep(/** @type {import("./index.js").ActionLike} */ action) {
    const { scalars: [reward, terminal], value: observation } = await this.#ask(RL.ENV_STEP, [], action);
    return { reward, terminal: terminal !== false, observation, truncated: terminal === CUT_OFF };
  }

  async agentStart(/** @type {import("./index.js").ObservationLike} */ observation) {
    return (await this.#ask(RL.AGENT_START, [], observation)).value;
  }

  async agentStep(/** @type {number} */ reward, /** @type {import("./index.js").ObservationLike} */ observation) {
    return (await this.#ask(RL.AGENT_STEP, [reward], observation)).value;
  }

  async agentEnd(/** @type {number} */ reward) {
    await this.#ask(RL.AGENT_END, [reward]);
  }

  async agentSave() {
    return (await this.#ask(RL.AGENT_SAVE)).value;
  }

  async agentLoad(/** @type {Uint8Array} */ data) {
    await this.#ask(RL.AGENT_LOAD, [], data);
  }

  async agentMetrics() {
    const { doubles, chars } = (await this.#ask(RL.AGENT_METRICS)).value;
    const names = Buffer.from(chars).toString().split("\n");
    return Object.fromEntries(Array.from(doubles, (value, i) => [names[i], value]));
  }

  async envSave() {
    return (await this.#ask(RL.ENV_SAVE)).value;
  }

  async envLoad(/** @type {Uint8Array} */ data) {
    await this.#ask(RL.ENV_LOAD, [], data);
  }

  async close(reason = "the experiment is over") {
    const error = new HubClosed("this experiment was closed");
    this.#over ??= error;
    await this.#link.close(reason);
    this.#fail(error);
  }

  /** @param {number} kind @param {any[]} [scalars] @param {any} [value] @returns {Promise<Message>} */
  async #ask(kind, scalars = [], value = undefined) {
    if (this.#pending !== null) throw new GlueError("a request is under way: await each before the next");
    if (this.#over !== null) throw this.#over;
    const forgotten = this.#forgotten;
    this.#forgotten = null;
    if (forgotten !== null && kind !== RL.INIT) throw forgotten;
    const frames = encode(kind, this.#link.session, this.#seq + 1, scalars, value, this.#link.takes);
    if (frames.length === 2 && frames[1].length > this.#link.maxBody) {
      throw new RangeError(`a body has ${frames[1].length} bytes; the hub takes ${this.#link.maxBody}`);
    }
    this.#seq += 1;
    return new Promise((resolve, reject) => {
      this.#pending = { seq: this.#seq, kind, frames, resolve, reject };
      if (this.#link.welcomed) this.#link.send(frames);
    });
  }

  /** @param {boolean} resumed */
  #welcomed(resumed) {
    if (!resumed && this.#answered) {
      this.#answered = false;
      const error = new HubClosed("the hub knows nothing of this experiment: it was restarted, or had given it up");
      if (this.#pending === null) this.#forgotten = error;
      else this.#fail(error);
    } else if (this.#pending !== null) {
      this.#link.send(this.#pending.frames);
    }
  }

  /** @param {Message} message */
  #received({ kind, seq, scalars, ...rest }) {
    if (kind === NOTICE) {
      const [event, role, name] = scalars;
      this.#onNotice?.(event, role, name);
    } else if (this.#pending !== null && seq === this.#pending.seq) {
      if (kind === ERROR) {
        const [code, text] = scalars;
        this.#answered = true;
        this.#fail(new (ERRORS[code] ?? GlueError)(text, code));
      } else if (kind === this.#pending.kind) {
        this.#answered = true;
        const { resolve } = this.#pending;
        this.#pending = null;
        resolve({ kind, seq, scalars, ...rest });
      }
    } else if (kind === ERROR) {
      this.#link.log(`the hub says: ${scalars[1]}`);
    }
  }

  /** @param {Error} error */
  #fail(error) {
    this.#pending?.reject(error);
    this.#pending = null;
  }
}

/** @type {typeof import("./index.js").connect} */
export async function connect(options = {}) {
  const experiment = new Experiment(options);
  await experiment.joined;
  return experiment;
}
