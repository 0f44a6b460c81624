// The codec against glue/testing/vectors.json, which docs/clients.md describes.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import test from "node:test";
import { legal, readObservation, writeAction, writeObservation } from "../src/body.js";
import { packExtras, unpackExtras } from "../src/extras.js";
import { maskFault, maskSizes } from "../src/masks.js";
import { decode, encode } from "../src/messages.js";
import { MessageReader, GREETING, READY, frameHead } from "../src/zmtp.js";

const path = process.env.GLUE_VECTORS ?? new URL("../../../glue/testing/vectors.json", import.meta.url);
const vectors = JSON.parse(readFileSync(path, "utf8"));

/** @param {string} hex */
const bytes = (hex) => Buffer.from(hex, "hex");

/** @param {string} hex */
const double = (hex) => bytes(hex).readDoubleBE();

/** @param {any} item @returns {any} */
function scalar(item) {
  const [[type, value]] = Object.entries(item);
  switch (type) {
    case "int": return BigInt(value);
    case "float": return double(value);
    case "binary": return bytes(value);
    case "nil": return undefined;
    case "array": return value.map(scalar);
    default: return value;
  }
}

/** @param {{ ints: number[], doubles: string[], chars: string, mask?: string, extras?: string }} one */
const abstract = ({ ints, doubles, chars, mask, extras }) => ({
  ints: Int32Array.from(ints), doubles: Float64Array.from(doubles, double), chars: new Uint8Array(bytes(chars)),
  ...(mask && { mask: Uint8Array.from({ length: 4 * mask.length }, (_, i) => (bytes(mask)[i >> 3] >> (i & 7)) & 1) }),
  ...(extras && { extras: unpackExtras(bytes(extras)) }),
});

/** @param {any} body @returns {any} */
function valueOf(body) {
  if (body === null) return undefined;
  if ("text" in body) return body.text;
  if ("bytes" in body) return new Uint8Array(bytes(body.bytes));
  const values = body.abstract.map(abstract);
  return values.length === 2 ? values : values[0];
}

/** A terminal is no bigint. @param {any} value @param {number} i @param {any[]} all */
const terminal = (value, i, all) => (value === 2n && typeof all[i - 1] === "number" ? 2 : value);

/** Bigints as numbers where they are exact. @param {any} value @returns {any} */
function numeric(value) {
  if (Array.isArray(value)) return value.map(numeric);
  if (value instanceof Buffer) return new Uint8Array(value);
  return typeof value === "bigint" && Number.isSafeInteger(Number(value)) ? Number(value) : value;
}

/** @param {any} value */
const exact = (value) => (typeof value === "number" && Number.isInteger(value) && !Object.is(value, -0) ? BigInt(value) : value);

const ROLES = ["peer", "agent", "environment", "experiment"];
const ours = (/** @type {any} */ { from, to }) => ROLES.includes(from) || ROLES.includes(to);
const messages = [...vectors.messages, ...vectors.accepted, ...vectors.truncate, ...vectors.beside, ...vectors.pace].filter(ours);

for (const { name, kind, code, session, seq, scalars, body, frames, ...entry } of messages) {
  const wire = frames.map(bytes);
  if (entry.from === "hub") {
    test(`decodes ${kind}, ${name}`, () => {
      const message = decode(wire[0], wire[1]);
      assert.deepEqual([message.kind, message.session, exact(message.seq)], [code, session, BigInt(seq)]);
      assert.deepEqual(message.scalars.map(exact), scalars.map(scalar).map(exact));
      assert.deepEqual(message.value, valueOf(body));
    });
  } else {
    test(`encodes ${kind}, ${name}`, () => {
      const encoded = encode(code, session, BigInt(seq), scalars.map(scalar).map(terminal), valueOf(body));
      assert.deepEqual(encoded.map((frame) => frame.toString("hex")), frames);
    });
  }
}

for (const { name, hex, values } of vectors.extras.accepted) {
  test(`reads and writes extras: ${name}`, () => {
    const expected = Object.fromEntries(Object.entries(values).map(([key, value]) => [key, numeric(scalar(value))]));
    assert.deepEqual(unpackExtras(bytes(hex)), expected);
    if (Object.keys(expected).length > 0) assert.deepEqual(unpackExtras(packExtras(expected)), expected);
  });
}

for (const { name, hex } of vectors.extras.refused) {
  test(`refuses extras: ${name}`, () => assert.throws(() => unpackExtras(bytes(hex)), { name: "ProtocolError" }));
}

/** @type {Record<string, any>} */
const NOT_SENT = {
  "an empty name": { "": 1 },
  "a name with a line feed": { "a\nb": 1 },
  "a long name": { ["a".repeat(65)]: 1 },
  "65 extras": Object.fromEntries(Array.from({ length: 65 }, (_, i) => [`n${i}`, i])),
  "large extras": { large: new Uint8Array(65535) },
  "huge extras": { huge: new Float64Array(70000) },
  "a huge text": { huge: "ü".repeat(40000) },
  "an int of 2^63": { int: 2n ** 63n },
  "an array in an array": { nested: [[1]] },
  "an array of texts": { texts: ["a"] },
  "an array of nothing": { nothing: [undefined, 1] },
  "an array with a hole": { hole: [, 1] },
  "a map": new Map([["coins", 3]]),
  "an object": { object: {} },
  null: { nothing: null },
  "a bool": { bool: true },
};

for (const [name, extras] of Object.entries(NOT_SENT)) {
  test(`does not send ${name}`, () => assert.throws(() => writeObservation({ extras }, true, true), /an extra|extras|integers are from -2/));
}

test("sends what the hub takes", () => {
  const observation = { ints: [7], mask: [false, true, true], extras: { coins: 3 } };
  const [mask, extras] = [{ ints: [7], mask: [0, 1, 1] }, { ints: [7], extras: { coins: 3 } }];
  assert.deepEqual(writeObservation(observation, true, false), writeObservation(mask, true, true));
  assert.deepEqual(writeObservation(observation, false, true), writeObservation(extras, true, true));
  assert.deepEqual(writeObservation(observation, false, false), writeAction({ ints: [7] }));
  assert.throws(() => writeObservation({ mask: { length: 8 * 65535 + 1 } }, true, true), RangeError);
});

test("says what is legal", () => {
  const observation = readObservation(writeObservation({ mask: [false, true, true] }, true, true), false);
  assert.deepEqual([0, 1, 2, 3, 8].map((value) => legal(observation, value)), [false, true, true, false, false]);
  assert.equal(legal(readObservation(writeAction({}), false), 9), true);
});

for (const { name, frames } of vectors.refused) {
  test(`refuses ${name}`, () => {
    const [header, body, ...more] = frames.map(bytes);
    assert.throws(() => {
      if (more.length === 0) decode(header, body);
      else readMessages(`${frames.map((/** @type {string} */ frame, /** @type {number} */ i) => (i < 2 ? "01" : "00") + (frame.length / 2).toString(16).padStart(2, "0") + frame).join("")}`);
    }, { name: "ProtocolError" });
  });
}

/** @param {string} hex @returns {any[]} */
function readMessages(hex) {
  /** @type {any[]} */
  const read = [];
  const reader = new MessageReader({
    command: (name, data) => read.push([name, data.toString("hex")]),
    message: (frames) => read.push(frames.map((frame) => frame.toString("hex"))),
  });
  for (const byte of bytes(hex)) reader.receive(Buffer.from([byte]));
  return read;
}

test("speaks ZMTP", () => {
  const { zmtp } = vectors;
  assert.equal(GREETING.toString("hex"), zmtp.greeting);
  assert.equal(Buffer.concat([frameHead(4, READY.length), READY]).toString("hex"), zmtp.ready);
  assert.deepEqual(readMessages(zmtp["ping with a context"]), [["PING", "012c616263"]]);
});

for (const { name, wire, frames, from } of vectors.messages) {
  if (from === "hub") {
    test(`reads the wire of ${name}`, () => assert.deepEqual(readMessages(wire), [frames]));
  }
}

for (const { name, hex } of vectors.zmtp.refused.filter((/** @type {any} */ one) => !one.name.includes("ERROR"))) {
  test(`refuses ${name}`, () => assert.throws(() => readMessages(hex), { name: "ProtocolError" }));
}

test("finds ints without a legal value", () => {
  const sizes = maskSizes("OBSERVATIONS INTS (0 9) Actions DOUBLES (0 1) ints (0 1)( 2 -1 1 ) CHARCOUNT 2 REWARDS (0 1)");
  assert.deepEqual(sizes, [2, 3, 3]);
  for (const unknown of ["ACTIONS INTS (0 UNSPEC) REWARDS", "a mirror", "ACTIONS DOUBLES (0 1) REWARDS EXTRA INTS (0 1)"]) {
    assert.deepEqual(maskSizes(unknown), []);
  }
  const fault = (/** @type {string} */ bits, /** @type {number[]} */ of) => maskFault([...bits].map(Number), of);
  assert.deepEqual([fault("01001100", sizes), fault("", sizes), fault("0", [])], ["", "", ""]);
  assert.equal(fault("01000110", sizes), "no value of int 1 is legal");
  assert.match(fault("111111111", sizes), /9 values, and the ints of an action have 8/);
  assert.match(fault("1111111", sizes), /7 values/);
  assert.match(fault("10101", [2, 2]), /5 values/);
});
