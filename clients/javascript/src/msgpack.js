// As much of msgpack as headers, which are arrays, and extras, which are maps, need: read and written item by item.
//
// The kind of a message says which items its header has, so they are asked for by type, and nothing else is accepted.

import { ProtocolError } from "./errors.js";

export const MAX_ITEMS = 64;
const MAX_INT = 2n ** 63n - 1n;
const MAX_EXACT = 2 ** 53;

const UTF8 = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });

const DOUBLE = new DataView(new ArrayBuffer(8));

/** Writes items, one after another. */
export class Packer {
  /** @type {number[]} */
  #bytes = [];

  /** @param {number} items @returns {this} */
  array(items) {
    if (items < 16) this.#bytes.push(0x90 | items);
    else this.#bytes.push(0xdc, items >> 8, items & 0xff);
    return this;
  }

  /** Begin a map. @param {number} items each a key and a value @returns {this} */
  map(items) {
    if (items < 16) this.#bytes.push(0x80 | items);
    else this.#bytes.push(0xde, items >> 8, items & 0xff);
    return this;
  }

  /** An integer from 0 to 2^63 - 1. @param {number | bigint} value @returns {this} */
  int(value) {
    const whole = BigInt(value); // throws a RangeError for 0.5
    if (whole < 0n || whole > MAX_INT) throw new RangeError(`integers are from 0 to 2^63 - 1, not ${value}`);
    const small = Number(whole);
    if (small < 0x80) this.#bytes.push(small);
    else if (small < 0x100) this.#bytes.push(0xcc, small);
    else if (small < 0x10000) this.#bytes.push(0xcd, small >> 8, small & 0xff);
    else if (small < 0x100000000) this.#bytes.push(0xce, small >>> 24, (small >> 16) & 0xff, (small >> 8) & 0xff, small & 0xff);
    else {
      DOUBLE.setBigUint64(0, whole);
      this.#put(0xcf);
    }
    return this;
  }

  /** An integer from -2^63 to 2^63 - 1. @param {number | bigint} value @returns {this} */
  signed(value) {
    if (value < ~MAX_INT || value > MAX_INT) throw new RangeError(`integers are from -2^63 to 2^63 - 1, not ${value}`);
    if (value >= 0) return this.int(value);
    const small = Number(value);
    if (small >= -0x20) this.#bytes.push(small & 0xff);
    else if (small >= -0x80) this.#bytes.push(0xd0, small & 0xff);
    else if (small >= -0x8000) this.#bytes.push(0xd1, (small >> 8) & 0xff, small & 0xff);
    else if (small >= -0x80000000) this.#bytes.push(0xd2, (small >> 24) & 0xff, (small >> 16) & 0xff, (small >> 8) & 0xff, small & 0xff);
    else {
      DOUBLE.setBigInt64(0, BigInt(value));
      this.#put(0xd3);
    }
    return this;
  }

  /** @param {number} value @returns {this} */
  float(value) {
    DOUBLE.setFloat64(0, value);
    this.#put(0xcb);
    return this;
  }

  /** @param {boolean} value @returns {this} */
  bool(value) {
    this.#bytes.push(value ? 0xc3 : 0xc2);
    return this;
  }

  /** @returns {this} */
  nil() {
    this.#bytes.push(0xc0);
    return this;
  }

  /** @param {string | Buffer} value a text, or its UTF-8 @returns {this} */
  text(value) {
    const utf8 = typeof value === "string" ? Buffer.from(value, "utf8") : value;
    const { length } = utf8;
    if (length < 32) this.#bytes.push(0xa0 | length);
    else if (length < 0x100) this.#bytes.push(0xd9, length);
    else this.#bytes.push(0xda, length >> 8, length & 0xff);
    this.#bytes.push(...utf8);
    return this;
  }

  /** @param {Uint8Array} value up to 65,535 bytes @returns {this} */
  binary(value) {
    const { length } = value;
    if (length < 0x100) this.#bytes.push(0xc4, length);
    else this.#bytes.push(0xc5, length >> 8, length & 0xff);
    this.#bytes.push(...value);
    return this;
  }

  /** @returns {Buffer} */
  finish() {
    return Buffer.from(this.#bytes);
  }

  /** @param {number} tag of the eight bytes in DOUBLE */
  #put(tag) {
    this.#bytes.push(tag);
    for (let at = 0; at < 8; at += 1) this.#bytes.push(DOUBLE.getUint8(at));
  }
}

/** @typedef {"int" | "float" | "text" | "binary" | "array" | "other"} Type */

/** Reads items, one after another; anything but what is asked for is a ProtocolError. */
export class Unpacker {
  #bytes;
  #what;
  #at = 0;
  #left = 1; // items that have not been read

  /** @param {Buffer} bytes @param {string} what they are, in errors */
  constructor(bytes, what) {
    this.#bytes = bytes;
    this.#what = what;
  }

  /** The type of the next item, which is not read. @returns {Type} */
  next() {
    const tag = this.#bytes[this.#at] ?? 0xc1;
    if (tag < 0x80 || tag >= 0xe0 || (tag >= 0xcc && tag <= 0xd3)) return "int";
    if (tag === 0xca || tag === 0xcb) return "float";
    if ((tag & 0xe0) === 0xa0 || (tag >= 0xd9 && tag <= 0xdb)) return "text";
    if (tag >= 0xc4 && tag <= 0xc6) return "binary";
    return (tag & 0xf0) === 0x90 || tag === 0xdc || tag === 0xdd ? "array" : "other";
  }

  /** How many bytes have not been read, which is no less than the number of items. */
  get remaining() {
    return this.#bytes.length - this.#at;
  }

  /** The number of items of an array, whose items come next. @param {number} [most] @returns {number} */
  array(most = MAX_ITEMS) {
    const tag = this.#tag();
    const items =
      (tag & 0xf0) === 0x90 ? tag & 0x0f
      : tag === 0xdc ? this.#uint(2)
      : tag === 0xdd ? this.#uint(4)
      : this.#fail("an array", tag);
    return this.#items(items, most, 1);
  }

  /** The number of items of a map; of each the key comes next, and then the value. @returns {number} */
  map() {
    const tag = this.#tag();
    const items =
      (tag & 0xf0) === 0x80 ? tag & 0x0f
      : tag === 0xde ? this.#uint(2)
      : tag === 0xdf ? this.#uint(4)
      : this.#fail("a map", tag);
    return this.#items(items, MAX_ITEMS, 2);
  }

  /** An integer as a number where that is exact, else as a bigint. @returns {number | bigint} */
  int() {
    const tag = this.#tag();
    const value = this.#integer(tag) ?? this.#fail("an integer", tag);
    if (value < 0 || value > MAX_INT) throw this.wrong(`has the integer ${value}, and they are from 0 to 2^63 - 1`);
    return value;
  }

  /** An integer, which may be negative. @returns {number | bigint} */
  signed() {
    const tag = this.#tag();
    const value = this.#integer(tag) ?? this.#fail("an integer", tag);
    if (value > MAX_INT) throw this.wrong(`has the integer ${value}, which is beyond 2^63 - 1`);
    return value;
  }

  /** @returns {number} */
  float() {
    const tag = this.#tag();
    if (tag === 0xcb) return this.#bytes.readDoubleBE(this.#skip(8));
    if (tag === 0xca) return this.#bytes.readFloatBE(this.#skip(4));
    const value = this.#integer(tag) ?? this.#fail("a float", tag);
    if (value > MAX_EXACT || value < -MAX_EXACT) throw this.wrong(`has ${value} for a float, which may be an integer up to 2^53`);
    return Number(value);
  }

  /** A bool, which may be an integer: all but 0 are true. @returns {number} */
  flag() {
    const tag = this.#tag();
    if (tag === 0xc2 || tag === 0xc3) return tag - 0xc2;
    return Number(this.#integer(tag) ?? this.#fail("a bool", tag));
  }

  /** @returns {string} */
  text() {
    const tag = this.#tag();
    const size =
      (tag & 0xe0) === 0xa0 ? tag & 0x1f
      : tag === 0xd9 ? this.#uint(1)
      : tag === 0xda ? this.#uint(2)
      : tag === 0xdb ? this.#uint(4)
      : this.#fail("a text", tag);
    const start = this.#skip(size);
    try {
      return UTF8.decode(this.#bytes.subarray(start, start + size));
    } catch {
      throw this.wrong("has a text that is not UTF-8");
    }
  }

  /** @returns {Uint8Array} */
  binary() {
    const tag = this.#tag();
    const size = tag >= 0xc4 && tag <= 0xc6 ? this.#uint(1 << (tag - 0xc4)) : this.#fail("bytes", tag);
    const start = this.#skip(size);
    return new Uint8Array(this.#bytes.subarray(start, start + size));
  }

  /** Check that nothing follows. */
  end() {
    if (this.#left !== 0 || this.#at !== this.#bytes.length) {
      throw this.wrong("has more items than it should have");
    }
  }

  /** @param {string} text */
  wrong(text) {
    return new ProtocolError(`${this.#what} ${text}`);
  }

  /** @param {number} items @param {number} most @param {number} each */
  #items(items, most, each) {
    if (items > most) throw this.wrong(`has an array or a map of ${items} items, and at most ${most} are allowed`);
    this.#left += each * items;
    return items;
  }

  #tag() {
    if (this.#left === 0) throw this.wrong("has fewer items than it should have");
    this.#left -= 1;
    return this.#bytes[this.#skip(1)];
  }

  /** @param {number} tag @returns {number | bigint | undefined} */
  #integer(tag) {
    if (tag < 0x80) return tag;
    if (tag >= 0xe0) return tag - 0x100;
    switch (tag) {
      case 0xcc: return this.#uint(1);
      case 0xcd: return this.#uint(2);
      case 0xce: return this.#uint(4);
      case 0xcf: return exact(this.#bytes.readBigUInt64BE(this.#skip(8)));
      case 0xd0: return this.#bytes.readInt8(this.#skip(1));
      case 0xd1: return this.#bytes.readInt16BE(this.#skip(2));
      case 0xd2: return this.#bytes.readInt32BE(this.#skip(4));
      case 0xd3: return exact(this.#bytes.readBigInt64BE(this.#skip(8)));
      default: return undefined;
    }
  }

  /** @param {number} size @returns {number} */
  #uint(size) {
    return this.#bytes.readUIntBE(this.#skip(size), size);
  }

  /** @param {number} size @returns {number} where the skipped bytes begin */
  #skip(size) {
    const start = this.#at;
    if (start + size > this.#bytes.length) throw this.wrong("ends in the middle of an item");
    this.#at = start + size;
    return start;
  }

  /** @param {string} expected @param {number} tag @returns {never} */
  #fail(expected, tag) {
    throw this.wrong(`has the byte 0x${tag.toString(16)} where ${expected} was expected`);
  }
}

/** @param {bigint} value @returns {number | bigint} */
function exact(value) {
  return value >= Number.MIN_SAFE_INTEGER && value <= Number.MAX_SAFE_INTEGER ? Number(value) : value;
}
