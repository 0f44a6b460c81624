// Observations and actions as they cross the wire: docs/protocol-reference.md, "Bodies".

import { ProtocolError } from "./errors.js";

const NO_CHARS = new Uint8Array(0);

/**
 * The length of the abstract type that a body begins with, checked against the length of the body.
 *
 * @param {Buffer} body @returns {number}
 */
function sizeOf(body) {
  if (body.length < 16) throw new ProtocolError(`an observation or action has 16 bytes or more, not ${body.length}`);
  if (body.readUInt32LE(12) !== 0) throw new ProtocolError("bytes 12 to 15 of an observation or action are zero");
  const size = 16 + 8 * body.readUInt32LE(4) + 4 * body.readUInt32LE(0) + body.readUInt32LE(8);
  if (size > body.length) {
    throw new ProtocolError(`an observation or action has ${body.length} bytes, by its counts ${size}`);
  }
  return size;
}

/** @param {Buffer} body @returns {import("./index.js").AbstractType} */
export function readAbstract(body) {
  if (sizeOf(body) !== body.length) throw new ProtocolError("bytes follow an observation or action");
  return read(body);
}

/** @param {Buffer} body @returns {[import("./index.js").AbstractType, import("./index.js").AbstractType]} */
export function readBoth(body) {
  const size = sizeOf(body);
  return [read(body.subarray(0, size)), readAbstract(body.subarray(size))];
}

/** @param {Uint8Array} body */
function read(body) {
  const view = new DataView(body.buffer, body.byteOffset, body.byteLength);
  const ints = new Int32Array(view.getUint32(0, true));
  const doubles = new Float64Array(view.getUint32(4, true));
  const atInts = 16 + 8 * doubles.length;
  const atChars = atInts + 4 * ints.length;
  for (let i = 0; i < doubles.length; i += 1) doubles[i] = view.getFloat64(16 + 8 * i, true);
  for (let i = 0; i < ints.length; i += 1) ints[i] = view.getInt32(atInts + 4 * i, true);
  return { ints, doubles, chars: new Uint8Array(body.subarray(atChars)) };
}

/** @param {import("./index.js").AbstractTypeLike} value @returns {Buffer} */
export function writeAbstract({ ints = [], doubles = [], chars = NO_CHARS }) {
  const atInts = 16 + 8 * doubles.length;
  const atChars = atInts + 4 * ints.length;
  const body = Buffer.alloc(atChars + chars.length);
  const view = new DataView(body.buffer, body.byteOffset, body.byteLength);
  view.setUint32(0, ints.length, true);
  view.setUint32(4, doubles.length, true);
  view.setUint32(8, chars.length, true);
  for (let i = 0; i < doubles.length; i += 1) view.setFloat64(16 + 8 * i, doubles[i], true);
  for (let i = 0; i < ints.length; i += 1) {
    if ((ints[i] | 0) !== ints[i]) throw new RangeError(`ints[${i}] is ${ints[i]}, which is no integer of 32 bits`);
    view.setInt32(atInts + 4 * i, ints[i], true);
  }
  body.set(chars, atChars);
  return body;
}
