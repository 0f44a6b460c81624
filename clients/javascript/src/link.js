// A peer's place in a session: greetings, heartbeats, and reconnecting after a break.

import { randomBytes } from "node:crypto";
import { ConfigError, GlueError, HubClosed, ProtocolError, Refused } from "./errors.js";
import { decode, encode, ERROR, GOODBYE, HEARTBEAT, HELLO, MAX_BODY, REFUSE, WELCOME } from "./messages.js";
import { Dealer } from "./dealer.js";

const DEFAULT_HUB = "tcp://127.0.0.1:4097";
const DEFAULT_SESSION = "default";
const DEFAULT_HEARTBEAT_MS = 1000;
const DEFAULT_TIMEOUT_MS = 5000;
const MAX_TEXT = 1000;

const CODEC = `JavaScript, Node ${process.versions.node}`;

/** @typedef {import("./messages.js").Message} Message */

/**
 * What the program at this end does with what the hub says. `failed` comes last, and once.
 *
 * @typedef {{ welcomed(resumed: boolean): void, received(message: Message, frames: Buffer[]): void, failed(error: Error): void }} Peer
 */

export class Link {
  /** Counts the connections that were greeted; also the seq of the HELLO. */
  greeted = 0;
  /** Whether the hub has welcomed us over the latest connection. */
  welcomed = false;
  /** The largest body that the hub accepts. */
  maxBody = MAX_BODY;
  /** What the hub takes beside an observation. */
  takes = { mask: false, extras: false };
  session;
  #hub;
  #role;
  #name;
  #capabilities;
  #peer;
  /** Receives lines for people. */
  log;
  #dealer;
  #instance = randomBytes(16);
  #heartbeatMs = DEFAULT_HEARTBEAT_MS;
  #timeoutMs = DEFAULT_TIMEOUT_MS;
  #timer;
  #waiting = false;
  #ended = false;

  /**
   * @param {string} role
   * @param {string} name
   * @param {string[]} capabilities
   * @param {import("./index.js").Options} options
   * @param {Peer} peer
   */
  constructor(role, name, capabilities, options, peer) {
    this.#hub = options.hub ?? process.env.GLUE_HUB ?? DEFAULT_HUB;
    this.session = options.session ?? process.env.GLUE_SESSION ?? DEFAULT_SESSION;
    if (!/^[^\p{C}\p{Zl}\p{Zp}]{1,255}$/u.test(this.session)) {
      throw new ConfigError(`the name of a session has 1 to 255 printable characters, not ${JSON.stringify(this.session)}`);
    }
    if (process.env.GLUE_KEY || process.env.GLUE_HUB_KEY) {
      throw new ConfigError("this library has no encryption: unset GLUE_KEY and GLUE_HUB_KEY, or write in C++ or Python");
    }
    this.log = options.log ?? ((line) => console.error(line));
    this.#role = role;
    this.#name = name;
    this.#capabilities = capabilities;
    this.#peer = peer;
    this.#dealer = new Dealer(this.#hub, {
      connected: () => this.#greet(),
      disconnected: () => { this.welcomed = false; },
      message: (frames) => this.#receive(frames),
      failed: (error) => this.fail(error),
      log: this.log,
    });
    this.#timer = setInterval(() => this.#tick(), this.#heartbeatMs);
  }

  /** Send a message to the hub. @param {number} kind @param {number | bigint} seq @param {any[]} [scalars] */
  say(kind, seq, scalars) {
    this.send(encode(kind, this.session, seq, scalars));
  }

  /** Send frames; the body is not larger than `maxBody`. @param {Buffer[]} frames */
  send(frames) {
    this.#dealer.send(frames);
  }

  /** Say goodbye, and leave. @param {string} reason @returns {Promise<void>} */
  close(reason) {
    if (!this.#ended && this.welcomed) this.say(GOODBYE, 0, [clip(reason)]);
    this.#ended = true;
    clearInterval(this.#timer);
    return this.#dealer.close();
  }

  /** End with an error; only the first counts. @param {Error} error */
  async fail(error) {
    if (this.#ended) return;
    await this.close(error.message);
    this.#peer.failed(error);
  }

  #greet() {
    this.welcomed = false;
    this.greeted += 1;
    this.say(HELLO, this.greeted, [[1], this.#role, this.#instance, this.#name, CODEC, this.#capabilities]);
  }

  #tick() {
    this.#dealer.silence += 1;
    if (!this.welcomed && !this.#waiting) {
      this.#waiting = true;
      this.log(`no hub answers at ${this.#hub} yet; waiting for one (glue-hub and glue-experiment start one)`);
    }
    if (this.#dealer.silence * this.#heartbeatMs >= this.#timeoutMs) this.#dealer.drop();
    else if (this.welcomed && this.#dealer.silence > 1) this.say(HEARTBEAT, 0);
  }

  /** @param {Buffer[]} frames */
  #receive(frames) {
    if (this.#ended) return;
    try {
      const message = decode(frames[0], frames[1]);
      if (message.session === this.session) this.#dispatch(message, frames);
      else if (message.kind === ERROR && message.session === "") this.log(`the hub says: ${message.scalars[1]}`);
    } catch (error) {
      if (!(error instanceof GlueError)) throw error;
      this.fail(error instanceof ProtocolError ? new ProtocolError(`the hub at ${this.#hub} broke the protocol: ${error.message}`) : error);
    }
  }

  /** @param {Message} message @param {Buffer[]} frames */
  #dispatch(message, frames) {
    const { kind, seq, scalars } = message;
    switch (kind) {
      case WELCOME:
        this.#welcome(seq, scalars);
        break;
      case HEARTBEAT:
        break;
      case REFUSE:
        throw new Refused(`the hub at ${this.#hub} refused this ${this.#role}: ${scalars[1]}`, scalars[0]);
      case GOODBYE:
        this.welcomed = false; // a goodbye has no answer
        throw new HubClosed(scalars[0]);
      case ERROR:
        if (scalars[0] !== "unknown-peer") this.#peer.received(message, frames);
        // While a HELLO is unanswered, this error is about something sent before it.
        else if (this.welcomed) this.#greet();
        break;
      default:
        if (message.known) this.#peer.received(message, frames);
        else this.say(ERROR, seq, ["unknown-kind", `this ${this.#role} does not know kind ${kind}`]);
    }
  }

  /** @param {number | bigint} seq @param {any[]} scalars */
  #welcome(seq, [version, resumed, heartbeat, timeout, maxBody, capabilities = []]) {
    // A WELCOME to an earlier HELLO may be another hub's; a second one to the same HELLO says nothing new.
    if (seq !== this.greeted || this.welcomed) return;
    if (version !== 1) throw new ProtocolError(`version ${version} was chosen, and only 1 was offered`);
    this.maxBody = Math.min(Number(maxBody), MAX_BODY);
    this.takes = { mask: capabilities.includes("mask"), extras: capabilities.includes("extras") };
    // What is no number becomes the least.
    this.#heartbeatMs = heartbeat > 0.01 ? 1000 * Math.min(heartbeat, 60) : 10;
    this.#timeoutMs = 1000 * timeout > this.#heartbeatMs ? 1000 * timeout : this.#heartbeatMs;
    clearInterval(this.#timer);
    this.#timer = setInterval(() => this.#tick(), this.#heartbeatMs);
    if (this.#waiting) this.log(`the hub at ${this.#hub} is there`);
    this.#waiting = false;
    this.welcomed = true;
    this.#peer.welcomed(resumed);
  }
}

/** One line of at most a thousand bytes. @param {string} text @returns {string} */
export function clip(text) {
  const line = text.replace(/\s+/g, " ").trim();
  return new TextDecoder().decode(Buffer.from(line).subarray(0, MAX_TEXT)).replace(/\uFFFD$/, "");
}
