// The header of a message: a msgpack array, read and written item by item.
//
// The kind says which items come, so both are asked for by type, and nothing else is accepted.

import { ProtocolError } from "./errors.js";

const MAX_HEADER = 4096;
const MAX_ITEMS = 64;
const MAX_INT = 2n ** 63n - 1n;
const MAX_EXACT = 2 ** 53;

const UTF8 = new TextDecoder("utf-8", { fatal: true, ignoreBOM: true });

const DOUBLE = new DataView(new ArrayBuffer(8));

/** Writes a header, item by item; it begins with an array. */
export class HeaderWriter {
  /** @type {number[]} */
  #bytes = [];

  /** @param {number} items @returns {this} */
  array(items) {
    if (items < 16) this.#bytes.push(0x90 | items);
    else this.#bytes.push(0xdc, items >> 8, items & 0xff);
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

  /** @param {string} value @returns {this} */
  text(value) {
    const utf8 = Buffer.from(value, "utf8");
    const { length } = utf8;
    if (length < 32) this.#bytes.push(0xa0 | length);
    else if (length < 0x100) this.#bytes.push(0xd9, length);
    else this.#bytes.push(0xda, length >> 8, length & 0xff);
    this.#bytes.push(...utf8);
    return this;
  }

  /** @param {Uint8Array} value up to 255 bytes @returns {this} */
  binary(value) {
    this.#bytes.push(0xc4, value.length, ...value);
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

/** Reads a header, item by item; anything but what is asked for is a ProtocolError. */
export class HeaderReader {
  #bytes;
  #at = 0;
  #left = 1; // items that have not been read

  /** @param {Buffer} bytes */
  constructor(bytes) {
    if (bytes.length > MAX_HEADER) {
      throw new ProtocolError(`a header has at most ${MAX_HEADER} bytes, not ${bytes.length}`);
    }
    this.#bytes = bytes;
  }

  /** The number of items of an array, whose items come next. @returns {number} */
  array() {
    const tag = this.#tag();
    const items =
      (tag & 0xf0) === 0x90 ? tag & 0x0f
      : tag === 0xdc ? this.#uint(2)
      : tag === 0xdd ? this.#uint(4)
      : this.#fail("an array", tag);
    if (items > MAX_ITEMS) throw new ProtocolError(`an array of a header has at most ${MAX_ITEMS} items, not ${items}`);
    this.#left += items;
    return items;
  }

  /** An integer as a number where that is exact, else as a bigint. @returns {number | bigint} */
  int() {
    const tag = this.#tag();
    const value = this.#integer(tag) ?? this.#fail("an integer", tag);
    if (value < 0 || value > MAX_INT) throw new ProtocolError(`integers are from 0 to 2^63 - 1, not ${value}`);
    return value;
  }

  /** @returns {number} */
  float() {
    const tag = this.#tag();
    if (tag === 0xcb) return this.#bytes.readDoubleBE(this.#skip(8));
    if (tag === 0xca) return this.#bytes.readFloatBE(this.#skip(4));
    const value = this.#integer(tag) ?? this.#fail("a float", tag);
    if (value > MAX_EXACT || value < -MAX_EXACT) throw new ProtocolError(`a float may be an integer up to 2^53, not ${value}`);
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
      throw new ProtocolError("a text of a header is not UTF-8");
    }
  }

  /** Check that nothing follows. */
  end() {
    if (this.#left !== 0 || this.#at !== this.#bytes.length) {
      throw new ProtocolError("a header has other items than its kind says");
    }
  }

  #tag() {
    if (this.#left === 0) throw new ProtocolError("a header has fewer items than its kind says");
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
    if (start + size > this.#bytes.length) throw new ProtocolError("a header ends in the middle of an item");
    this.#at = start + size;
    return start;
  }

  /** @param {string} expected @param {number} tag @returns {never} */
  #fail(expected, tag) {
    throw new ProtocolError(`a header has ${expected} where the byte 0x${tag.toString(16)} was received`);
  }
}

/** @param {bigint} value @returns {number | bigint} */
function exact(value) {
  return value >= Number.MIN_SAFE_INTEGER && value <= Number.MAX_SAFE_INTEGER ? Number(value) : value;
}
