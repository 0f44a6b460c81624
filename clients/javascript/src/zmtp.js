// ZMTP 3.1 with the NULL mechanism, as the last appendix of docs/protocol-reference.md says: bytes, no sockets.

import { ConfigError, ProtocolError } from "./errors.js";
import { MAX_BODY } from "./messages.js";

export const MORE = 1, LONG = 2, COMMAND = 4;
export const GREETING_SIZE = 64;

const MAX_HEADER = 4096;
const MAX_COMMAND = 4096;
/** A body of an observation and an action. */
const MAX_FRAME = 2 * MAX_BODY;

export const GREETING = Buffer.alloc(GREETING_SIZE);
GREETING.set([0xff, 0, 0, 0, 0, 0, 0, 0, 0, 0x7f, 3, 1]);
GREETING.write("NULL", 12, "ascii");

export const READY = Buffer.from("\x05READY\x0bSocket-Type\0\0\0\x06DEALER\x08Identity\0\0\0\0", "latin1");

/** What comes before the bytes of a frame. @param {number} flags @param {number} length @returns {Buffer} */
export function frameHead(flags, length) {
  if (length < 256) return Buffer.from([flags, length]);
  const head = Buffer.alloc(9);
  head[0] = flags | LONG;
  head.writeBigUInt64BE(BigInt(length), 1);
  return head;
}

/** @param {Buffer} greeting of the other side */
export function checkGreeting(greeting) {
  if (greeting[0] !== 0xff || (greeting[9] & 1) === 0 || greeting[10] < 3) {
    throw new ProtocolError("it does not speak ZMTP 3: is this the address of a hub?");
  }
  const mechanism = greeting.toString("latin1", 12, 32).replace(/\0+$/, "");
  if (mechanism !== "NULL") {
    throw new ConfigError(`the hub wants ${mechanism}, and this library has no encryption: use another of its addresses`);
  }
}

/** Takes the bytes that follow the greeting, in pieces of any size, and makes messages and commands of them. */
export class MessageReader {
  #events;
  /** @type {Buffer[]} */
  #chunks = [];
  #size = 0; // of the chunks
  #needed = 2; // bytes, before anything can be done
  /** @type {Buffer | undefined} the first frame of a message of two */
  #header;

  /** @param {{ command(name: string, data: Buffer): void, message(frames: Buffer[]): void }} events */
  constructor(events) {
    this.#events = events;
  }

  /** @param {Buffer} chunk */
  receive(chunk) {
    this.#chunks.push(chunk);
    this.#size += chunk.length;
    if (this.#size < this.#needed) return;
    let rest = this.#chunks.length === 1 ? chunk : Buffer.concat(this.#chunks, this.#size);
    for (let frame; (frame = this.#frameOf(rest)) !== undefined; ) {
      rest = rest.subarray(frame.end);
      this.#take(frame.flags, frame.data);
    }
    this.#chunks = [rest];
    this.#size = rest.length;
  }

  /** The frame that bytes begin with, if all of it is there. @param {Buffer} bytes */
  #frameOf(bytes) {
    this.#needed = 2;
    if (bytes.length < this.#needed) return undefined;
    const flags = bytes[0];
    const start = flags & LONG ? 9 : 2;
    this.#needed = start;
    if (bytes.length < this.#needed) return undefined;
    const length = flags & LONG ? Number(bytes.readBigUInt64BE(1)) : bytes[1];
    this.#check(flags, length);
    const end = start + length;
    this.#needed = end;
    return bytes.length < end ? undefined : { flags, data: bytes.subarray(start, end), end };
  }

  /** @param {number} flags @param {number} length */
  #check(flags, length) {
    const command = (flags & COMMAND) !== 0;
    if (flags > (MORE | LONG | COMMAND) || (command && flags & MORE)) {
      throw new ProtocolError(`a frame has the flags ${flags}, which do not exist`);
    }
    if (!command && this.#header !== undefined && flags & MORE) throw new ProtocolError("a message has more than two frames");
    const most = command ? MAX_COMMAND : this.#header === undefined ? MAX_HEADER : MAX_FRAME;
    if (length > most) throw new ProtocolError(`a frame has ${length} bytes, and ${most} are allowed`);
  }

  /** @param {number} flags @param {Buffer} data */
  #take(flags, data) {
    if (flags & COMMAND) {
      const end = 1 + (data[0] ?? 0);
      this.#events.command(data.toString("latin1", 1, end), data.subarray(end));
    } else if (flags & MORE) {
      this.#header = data;
    } else {
      const frames = this.#header === undefined ? [data] : [this.#header, data];
      this.#header = undefined;
      this.#events.message(frames);
    }
  }
}
