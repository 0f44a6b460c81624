// Observations and actions as they cross the wire: docs/protocol-reference.md, "Bodies".

import { ProtocolError } from "./errors.js";
import { MAX_BESIDE, packExtras, unpackExtras } from "./extras.js";

/** @typedef {import("./index.js").Action} Action */
/** @typedef {import("./index.js").Observation} Observation */

const NOTHING = Buffer.alloc(0);
const HEAD = 16;
/** Where the sizes of mask and extras are, of 16 bits each. */
const AT_MASK = 12;
const AT_EXTRAS = 14;

/**
 * The length of the abstract type that a body begins with, checked against the length of the body.
 *
 * @param {Buffer} body @param {boolean} withMask @param {boolean} withExtras @returns {number}
 */
function sizeOf(body, withMask, withExtras) {
  if (body.length < HEAD) throw new ProtocolError(`an observation or action has 16 bytes or more, not ${body.length}`);
  const mask = body.readUInt16LE(AT_MASK);
  const extras = body.readUInt16LE(AT_EXTRAS);
  if (mask !== 0 && !withMask) throw new ProtocolError("an action has a mask");
  if (extras !== 0 && !withExtras) throw new ProtocolError("an agent was sent extras, which are not for it");
  const size = HEAD + 8 * body.readUInt32LE(4) + 4 * body.readUInt32LE(0) + body.readUInt32LE(8) + mask + extras;
  if (size > body.length) {
    throw new ProtocolError(`an observation or action has ${body.length} bytes, by its counts ${size}`);
  }
  return size;
}

/** @param {Buffer} body @param {number} size */
function checkEnd(body, size) {
  if (size !== body.length) throw new ProtocolError("bytes follow an observation or action");
}

/** @param {Buffer} body @returns {Action} */
export function readAction(body) {
  checkEnd(body, sizeOf(body, false, false));
  return readRuns(body)[0];
}

/** @param {Buffer} body @param {boolean} withExtras @returns {Observation} */
export function readObservation(body, withExtras) {
  checkEnd(body, sizeOf(body, true, withExtras));
  const [runs, end] = readRuns(body);
  const mask = body.subarray(end, end + body.readUInt16LE(AT_MASK));
  const extras = body.subarray(end + mask.length);
  return {
    ...runs,
    ...(mask.length > 0 && { mask: Uint8Array.from({ length: 8 * mask.length }, (_, i) => (mask[i >> 3] >> (i & 7)) & 1) }),
    ...(extras.length > 0 && { extras: unpackExtras(extras) }),
  };
}

/** @param {Buffer} body @returns {[Observation, Action]} */
export function readBoth(body) {
  const size = sizeOf(body, true, true);
  return [readObservation(body.subarray(0, size), true), readAction(body.subarray(size))];
}

/** The three runs of a body, and where they end. @param {Buffer} body @returns {[Action, number]} */
function readRuns(body) {
  const view = new DataView(body.buffer, body.byteOffset, body.byteLength);
  const ints = new Int32Array(view.getUint32(0, true));
  const doubles = new Float64Array(view.getUint32(4, true));
  const atInts = 16 + 8 * doubles.length;
  const atChars = atInts + 4 * ints.length;
  const end = atChars + view.getUint32(8, true);
  for (let i = 0; i < doubles.length; i += 1) doubles[i] = view.getFloat64(16 + 8 * i, true);
  for (let i = 0; i < ints.length; i += 1) ints[i] = view.getInt32(atInts + 4 * i, true);
  return [{ ints, doubles, chars: new Uint8Array(body.subarray(atChars, end)) }, end];
}

/** @type {typeof import("./index.js").legal} */
export const legal = ({ mask }, value) => mask === undefined || mask[value] === 1;

/** @param {import("./index.js").ActionLike} value @returns {Buffer} */
export function writeAction(value) {
  return write(value, NOTHING, NOTHING);
}

/**
 * An observation with as much beside it as the hub takes.
 *
 * @param {import("./index.js").ObservationLike} value @param {boolean} withMask @param {boolean} withExtras @returns {Buffer}
 */
export function writeObservation(value, withMask, withExtras) {
  const mask = packMask(value.mask ?? []);
  const extras = packExtras(value.extras ?? {});
  return write(value, withMask ? mask : NOTHING, withExtras ? extras : NOTHING);
}

/** @param {ArrayLike<boolean | number>} mask */
function packMask(mask) {
  const packed = Buffer.alloc((mask.length + 7) >> 3);
  if (packed.length > MAX_BESIDE) throw new RangeError(`a mask has at most ${8 * MAX_BESIDE} values, not ${mask.length}`);
  for (let i = 0; i < mask.length; i += 1) packed[i >> 3] |= mask[i] ? 1 << (i & 7) : 0;
  return packed;
}

/** @param {import("./index.js").ActionLike} runs @param {Buffer} mask @param {Buffer} extras */
function write({ ints = [], doubles = [], chars = NOTHING }, mask, extras) {
  const atInts = HEAD + 8 * doubles.length;
  const atChars = atInts + 4 * ints.length;
  const atMask = atChars + chars.length;
  const body = Buffer.alloc(atMask + mask.length + extras.length);
  const view = new DataView(body.buffer, body.byteOffset, body.byteLength);
  view.setUint32(0, ints.length, true);
  view.setUint32(4, doubles.length, true);
  view.setUint32(8, chars.length, true);
  view.setUint16(AT_MASK, mask.length, true);
  view.setUint16(AT_EXTRAS, extras.length, true);
  for (let i = 0; i < doubles.length; i += 1) view.setFloat64(HEAD + 8 * i, doubles[i], true);
  for (let i = 0; i < ints.length; i += 1) {
    if ((ints[i] | 0) !== ints[i]) throw new RangeError(`ints[${i}] is ${ints[i]}, which is no integer of 32 bits`);
    view.setInt32(atInts + 4 * i, ints[i], true);
  }
  body.set(chars, atChars);
  body.set(mask, atMask);
  body.set(extras, atMask + mask.length);
  return body;
}
