// Extras as they cross the wire: one map of msgpack, in which nothing is nested.

import { MAX_ITEMS, Packer, Unpacker } from "./msgpack.js";

/** @typedef {import("./index.js").Extra} Extra */
/** @typedef {import("./index.js").ExtraLike} ExtraLike */

/** The largest mask, and the largest extras, in bytes. */
export const MAX_BESIDE = 65535;
const NAME = /^[^\p{C}\p{Zl}\p{Zp}]{1,64}$/u;

/** @param {Readonly<Record<string, ExtraLike>>} extras @returns {Buffer} nothing if there are none */
export function packExtras(extras) {
  const kind = Object.getPrototypeOf(extras);
  if (kind !== Object.prototype && kind !== null) throw new TypeError("extras are a plain object, of values by name");
  const all = Object.entries(extras);
  if (all.length === 0) return Buffer.alloc(0);
  if (all.length > MAX_ITEMS) throw new RangeError(`an observation has at most ${MAX_ITEMS} extras, not ${all.length}`);
  const packer = new Packer().map(all.length);
  for (const [name, value] of all) {
    if (!NAME.test(name)) {
      throw new RangeError(`the name of an extra has 1 to 64 printable characters, not ${JSON.stringify(name)}`);
    }
    packExtra(packer.text(name), name, value);
  }
  return fitting(packer.finish(), "extras");
}

/** @param {Packer} packer @param {string} name @param {ExtraLike} value */
function packExtra(packer, name, value) {
  if (typeof value === "number" || typeof value === "bigint") packNumber(packer, value, isWhole(value));
  else if (typeof value === "string") packer.text(fitting(Buffer.from(value), name));
  else if (value instanceof Uint8Array) packer.binary(fitting(value, name));
  else if (Array.isArray(value) || (ArrayBuffer.isView(value) && "length" in value)) {
    const numbers = Array.from(/** @type {ArrayLike<number | bigint>} */ (fitting(value, name)));
    const odd = numbers.findIndex((one) => typeof one !== "number" && typeof one !== "bigint");
    if (odd >= 0) throw new TypeError(`an array among the extras is flat and of numbers; ${name} has ${typeof numbers[odd]}`);
    const whole = !(value instanceof Float64Array || value instanceof Float32Array) && numbers.every(isWhole);
    packer.array(numbers.length);
    for (const one of numbers) packNumber(packer, one, whole);
  } else {
    throw new TypeError(`an extra is a number, a text, bytes or an array of numbers; ${name} is ${value === null ? null : typeof value}`);
  }
}

/** @param {Packer} packer @param {number | bigint} value @param {boolean} whole */
function packNumber(packer, value, whole) {
  if (whole) packer.signed(value);
  else packer.float(Number(value));
}

/** Whether a number is sent as an integer. @param {number | bigint} value */
const isWhole = (value) => typeof value === "bigint" || (Number.isSafeInteger(value) && !Object.is(value, -0));

/**
 * What is not certainly too long: no item is shorter than a byte.
 *
 * @template {{ length: number }} T @param {T} items @param {string} name @returns {T}
 */
function fitting(items, name) {
  if (items.length > MAX_BESIDE) throw new RangeError(`the extras of an observation have at most ${MAX_BESIDE} bytes; ${name} has ${items.length}`);
  return items;
}

/** @param {Buffer} packed @returns {Record<string, Extra>} */
export function unpackExtras(packed) {
  const unpacker = new Unpacker(packed, "a map of extras");
  /** @type {Map<string, Extra>} */
  const extras = new Map();
  for (let left = unpacker.map(); left > 0; left -= 1) {
    const name = unpacker.text();
    if (!NAME.test(name)) throw unpacker.wrong("has a name that is not 1 to 64 printable characters");
    if (extras.has(name)) throw unpacker.wrong(`has the name ${name} twice`);
    extras.set(name, unpackExtra(unpacker));
  }
  unpacker.end();
  return Object.fromEntries(extras);
}

/** @param {Unpacker} unpacker @returns {Extra} */
function unpackExtra(unpacker) {
  const type = unpacker.next();
  switch (type) {
    case "int": return unpacker.signed();
    case "float": return unpacker.float();
    case "text": return unpacker.text();
    case "binary": return unpacker.binary();
    case "array": {
      // No item is shorter than a byte, so nothing large is allocated for a small message.
      const left = unpacker.array(unpacker.remaining);
      const items = unpacker.next();
      return Array.from({ length: left }, () => {
        if (unpacker.next() !== items || (items !== "int" && items !== "float")) {
          throw unpacker.wrong("has an array that is neither of ints nor of floats");
        }
        return items === "int" ? unpacker.signed() : unpacker.float();
      });
    }
    default: throw unpacker.wrong("has a value that is no number, text, bytes or array");
  }
}
