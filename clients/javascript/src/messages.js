// Every kind of message that an agent, an environment or an experiment sends or receives: docs/protocol-reference.md, "Every
// kind of message".

import { readAction, readBoth, readObservation, writeAction, writeObservation } from "./body.js";
import { ProtocolError } from "./errors.js";
import { Packer, Unpacker } from "./msgpack.js";

export const AGENT = { INIT: 4, START: 5, STEP: 6, END: 7, CLEANUP: 8, MESSAGE: 10, SEED: 80, SAVE: 81, LOAD: 82, METRICS: 86 };

export const ENV = { INIT: 11, START: 12, STEP: 13, CLEANUP: 14, MESSAGE: 19, SEED: 83, SAVE: 84, LOAD: 85 };

export const RL = {
  INIT: 20, START: 21, STEP: 22, CLEANUP: 23, RETURN: 24, NUM_STEPS: 25, NUM_EPISODES: 26, EPISODE: 27,
  AGENT_MESSAGE: 33, ENV_MESSAGE: 34, ENV_START: 36, ENV_STEP: 37, AGENT_START: 38, AGENT_STEP: 39, AGENT_END: 40,
  AGENT_SAVE: 90, AGENT_LOAD: 91, ENV_SAVE: 92, ENV_LOAD: 93,
  AGENT_METRICS: 94,
};

export const HELLO = 64, WELCOME = 65, REFUSE = 66, HEARTBEAT = 67, GOODBYE = 68, ERROR = 69, NOTICE = 70;

/** The terminal of an episode that was cut off, in a state that is not terminal. */
export const CUT_OFF = 2;

/** The largest text, bytes, observation or action. */
export const MAX_BODY = 16777216;
const MAX_HEADER = 4096;
const MAX_SESSION = 255;

/**
 * A message. Its `value` is what its body stands for: a text, bytes, an action or observation, or both; undefined if
 * its kind has no body. A kind that is not `known` has neither scalars nor a value.
 *
 * @typedef {{ kind: number, session: string, seq: number | bigint, scalars: any[], value: any, known: boolean }} Message
 */

/** @typedef {"int" | "float" | "bool" | "terminal" | "text" | "binary" | "ints" | "texts" | "pace" | "seed"} Scalar */
/** @typedef {"none" | "text" | "bytes" | "action" | "seen" | "observation" | "both"} Body agents have seen no extras */
/** @typedef {{ scalars: Scalar[], body: Body }} Shape */

/** @param {Body} body @param {Scalar[]} scalars @returns {Shape} */
const shape = (body, ...scalars) => ({ scalars, body });

/** @type {[number, Shape, Shape][]} requests and replies */
const CALLS = [
  [AGENT.INIT, shape("text"), shape("none")],
  [AGENT.START, shape("seen"), shape("action")],
  [AGENT.STEP, shape("seen", "float", "pace", "pace"), shape("action")],
  [AGENT.END, shape("none", "float"), shape("none")],
  [AGENT.CLEANUP, shape("none"), shape("none")],
  [AGENT.MESSAGE, shape("text"), shape("text")],
  [AGENT.SEED, shape("none", "int"), shape("none")],
  [AGENT.SAVE, shape("none"), shape("bytes")],
  [AGENT.LOAD, shape("bytes"), shape("none")],
  [AGENT.METRICS, shape("none"), shape("action")],
  [ENV.INIT, shape("none"), shape("text")],
  [ENV.START, shape("none"), shape("observation")],
  [ENV.STEP, shape("action"), shape("observation", "float", "terminal")],
  [ENV.CLEANUP, shape("none"), shape("none")],
  [ENV.MESSAGE, shape("text"), shape("text")],
  [ENV.SEED, shape("none", "int"), shape("none")],
  [ENV.SAVE, shape("none"), shape("bytes")],
  [ENV.LOAD, shape("bytes"), shape("none")],
];

/** @type {[number, Shape, Shape][]} */
const REQUESTS = [
  [RL.INIT, shape("none", "seed"), shape("text")],
  [RL.START, shape("none"), shape("both")],
  [RL.STEP, shape("none"), shape("both", "float", "terminal")],
  [RL.EPISODE, shape("none", "int"), shape("none", "terminal")],
  [RL.RETURN, shape("none"), shape("none", "float")],
  [RL.NUM_STEPS, shape("none"), shape("none", "int")],
  [RL.NUM_EPISODES, shape("none"), shape("none", "int")],
  [RL.AGENT_MESSAGE, shape("text"), shape("text")],
  [RL.ENV_MESSAGE, shape("text"), shape("text")],
  [RL.CLEANUP, shape("none"), shape("none")],
  [RL.ENV_START, shape("none"), shape("observation")],
  [RL.ENV_STEP, shape("action"), shape("observation", "float", "terminal")],
  [RL.AGENT_START, shape("seen"), shape("action")],
  [RL.AGENT_STEP, shape("seen", "float"), shape("action")],
  [RL.AGENT_END, shape("none", "float"), shape("none")],
  [RL.AGENT_SAVE, shape("none"), shape("bytes")],
  [RL.AGENT_LOAD, shape("bytes"), shape("none")],
  [RL.ENV_SAVE, shape("none"), shape("bytes")],
  [RL.ENV_LOAD, shape("bytes"), shape("none")],
  [RL.AGENT_METRICS, shape("none"), shape("action")],
];

/** @type {ReadonlyMap<number, Shape>} */
const TO_HUB = new Map([
  .../** @type {[number, Shape][]} */ (CALLS.map(([kind, , reply]) => [kind, reply])),
  .../** @type {[number, Shape][]} */ (REQUESTS.map(([kind, request]) => [kind, request])),
  [HELLO, shape("none", "ints", "text", "binary", "text", "text", "texts")],
  [HEARTBEAT, shape("none")],
  [GOODBYE, shape("none", "text")],
  [ERROR, shape("none", "text", "text")],
]);

/** @type {ReadonlyMap<number, Shape>} */
const FROM_HUB = new Map([
  .../** @type {[number, Shape][]} */ (CALLS.map(([kind, request]) => [kind, request])),
  .../** @type {[number, Shape][]} */ (REQUESTS.map(([kind, , reply]) => [kind, reply])),
  [WELCOME, shape("none", "int", "bool", "float", "float", "int", "texts")],
  [REFUSE, shape("none", "text", "text")],
  [HEARTBEAT, shape("none")],
  [GOODBYE, shape("none", "text")],
  [ERROR, shape("none", "text", "text")],
  [NOTICE, shape("none", "text", "text", "text")],
]);

/**
 * The frames of a message to the hub, with as much beside an observation as it takes.
 *
 * @param {number} kind @param {string} session @param {number | bigint} seq
 * @param {any[]} [scalars] @param {any} [value] @param {{ mask: boolean, extras: boolean }} [takes]
 * @returns {Buffer[]}
 */
export function encode(kind, session, seq, scalars = [], value = undefined, takes = { mask: true, extras: true }) {
  const { scalars: types, body } = /** @type {Shape} */ (TO_HUB.get(kind));
  const header = new Packer().array(3 + types.length).int(kind).text(session).int(seq);
  types.forEach((type, i) => writeScalar(header, type, scalars[i]));
  switch (body) {
    case "none": return [header.finish()];
    case "text": return [header.finish(), Buffer.from(value, "utf8")];
    case "bytes": return [header.finish(), Buffer.from(value)];
    case "action": return [header.finish(), writeAction(value)];
    default: return [header.finish(), writeObservation(value, takes.mask, takes.extras && body !== "seen")];
  }
}

/**
 * The message from the hub that frames stand for; a ProtocolError says what is wrong with them.
 *
 * @param {Buffer} header @param {Buffer} [body] @returns {Message}
 */
export function decode(header, body) {
  if (header.length > MAX_HEADER) {
    throw new ProtocolError(`a header has at most ${MAX_HEADER} bytes, not ${header.length}`);
  }
  const reader = new Unpacker(header, "a header");
  const items = reader.array();
  const kind = Number(reader.int());
  const session = reader.text();
  const seq = reader.int();
  if (session.length > MAX_SESSION && [...session].length > MAX_SESSION) {
    throw new ProtocolError(`the name of a session has at most ${MAX_SESSION} characters, not ${session.length}`);
  }
  const expected = FROM_HUB.get(kind);
  if (expected === undefined) return { kind, session, seq, scalars: [], value: undefined, known: false };
  // A hub that knows nothing of masks and extras omits the texts of its WELCOME, one that waits an agent's pace.
  const needed = expected.scalars.filter((type) => type !== "texts" && type !== "pace");
  const types = items > 3 + needed.length ? expected.scalars : needed;
  const scalars = types.map((type) => readScalar(reader, type));
  reader.end();
  return { kind, session, seq, scalars, value: readBody(expected.body, body), known: true };
}

/** @param {Body} expected @param {Buffer} [body] */
function readBody(expected, body) {
  if (expected === "none") {
    if (body !== undefined) throw new ProtocolError("a message has a body, and its kind has none");
    return undefined;
  }
  if (body === undefined) throw new ProtocolError("a message has no body, and its kind has one");
  switch (expected) {
    case "text": return body.toString("utf8");
    case "bytes": return new Uint8Array(body);
    case "action": return readAction(body);
    case "seen": return readObservation(body, false);
    case "observation": return readObservation(body, true);
    default: return readBoth(body);
  }
}

/** @param {Unpacker} reader @param {Scalar} type */
function readScalar(reader, type) {
  switch (type) {
    case "int": return reader.int();
    case "float": case "pace": return reader.float();
    case "bool": return reader.flag() !== 0;
    case "terminal": return terminalOf(reader.flag());
    case "texts": return Array.from({ length: reader.array() }, () => reader.text());
    default: return reader.text();
  }
}

/** True, false, or CUT_OFF. @param {number} flag */
const terminalOf = (flag) => (flag === CUT_OFF ? CUT_OFF : flag !== 0);

/** @param {Packer} header @param {Scalar} type @param {any} value */
function writeScalar(header, type, value) {
  switch (type) {
    case "int": return header.int(value);
    case "float": return header.float(value);
    case "bool": return header.bool(value);
    case "terminal": return value === CUT_OFF ? header.int(value) : header.bool(value);
    case "text": return header.text(value);
    case "binary": return header.binary(value);
    case "seed": return value === undefined ? header.nil() : header.int(value);
    case "ints": return value.reduce((/** @type {Packer} */ to, /** @type {number} */ one) => to.int(one), header.array(value.length));
    default: return value.reduce((/** @type {Packer} */ to, /** @type {string} */ one) => to.text(one), header.array(value.length));
  }
}
