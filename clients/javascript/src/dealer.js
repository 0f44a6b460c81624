// A ZeroMQ DEALER over tcp or a Unix socket.

import { lookup } from "node:dns/promises";
import net from "node:net";
import { ConfigError } from "./errors.js";
import { checkGreeting, COMMAND, frameHead, GREETING, GREETING_SIZE, MessageReader, MORE, READY } from "./zmtp.js";

const CHUNK = 65536;
const MAX_PATH = 107;
const RECONNECT_MS = 100;
/** How long the last messages may take to leave. */
const LINGER_MS = 1000;

/**
 * What happens to a dealer: there is a new connection; it has ended; a message of one or two frames; an error that
 * ends it all; a line for people.
 *
 * @typedef {{ connected(): void, disconnected(): void, message(frames: Buffer[]): void, failed(error: Error): void,
 *   log(line: string): void }} Events
 */

/** One connection after another to the same address, until `close`. */
export class Dealer {
  /** How many heartbeats have passed since anything was received; counted up by the owner. */
  silence = 0;
  #options;
  #events;
  /** @type {net.Socket | null} the connection, or the attempt to make one */
  #socket = null;
  #ready = false; // whether it can carry messages
  /** @type {NodeJS.Timeout | undefined} */
  #retry;
  #closed = false;

  /** @param {string} hub @param {Events} events */
  constructor(hub, events) {
    this.#options = optionsOf(hub);
    this.#events = events;
    this.#start();
  }

  /** Send a message. Without a connection it is lost, as when one breaks: the hub asks again. @param {Buffer[]} frames */
  send(frames) {
    if (!this.#ready) return;
    const last = frames.length - 1;
    this.#socket?.write(Buffer.concat(frames.flatMap((frame, i) => [frameHead(i < last ? MORE : 0, frame.length), frame])));
  }

  /** Give the connection up, and make another. */
  drop() {
    this.#socket?.destroy();
  }

  /** Close when what was sent has left. @returns {Promise<void>} */
  close() {
    this.#closed = true;
    clearTimeout(this.#retry);
    const socket = this.#socket;
    if (socket === null || socket.destroyed || !this.#ready) {
      socket?.destroy();
      return Promise.resolve();
    }
    return new Promise((resolve) => {
      const lingered = setTimeout(() => socket.destroy(), LINGER_MS);
      socket.once("close", () => {
        clearTimeout(lingered);
        resolve();
      });
      socket.end();
    });
  }

  async #start() {
    const { host } = /** @type {net.TcpNetConnectOpts} */ (this.#options);
    try {
      if (host !== undefined) await lookup(host);
      if (!this.#closed) this.#connect();
    } catch {
      this.#events.failed(new ConfigError(`the host ${host} is unknown`));
    }
  }

  #connect() {
    const begun = performance.now();
    // Into one buffer: a socket's "data" events allocate 64 KiB for each message.
    const onread = {
      buffer: Buffer.allocUnsafeSlow(CHUNK),
      callback: (/** @type {number} */ size, /** @type {Uint8Array} */ buffer) => {
        this.silence = 0;
        if (this.#closed) return true;
        try {
          receive(Buffer.from(buffer.subarray(0, size)));
        } catch (error) {
          socket.destroy();
          this.#events.failed(/** @type {Error} */ (error));
        }
        return true;
      },
    };
    const socket = net.connect({ ...this.#options, onread });
    this.#socket = socket;
    this.silence = 0;
    const receive = this.#receiver(socket);
    socket.on("connect", () => socket.write(GREETING));
    socket.on("error", () => {}); // "close" follows.
    socket.on("close", () => {
      const broken = this.#ready;
      this.#ready = false;
      if (this.#closed) return;
      if (broken) this.#events.disconnected();
      this.#retry = setTimeout(() => this.#connect(), RECONNECT_MS - (performance.now() - begun));
    });
  }

  /** Return what takes the bytes of one connection. @param {net.Socket} socket @returns {(chunk: Buffer) => void} */
  #receiver(socket) {
    const messages = new MessageReader({
      command: (name, data) => this.#command(socket, name, data),
      // A connection that was given up says no more.
      message: (frames) => { if (!this.#closed && !socket.destroyed) this.#events.message(frames); },
    });
    /** @type {Buffer | null} */
    let greeting = Buffer.alloc(0);
    return (chunk) => {
      let rest = chunk;
      if (greeting !== null) {
        greeting = Buffer.concat([greeting, chunk]);
        if (greeting.length < GREETING_SIZE) return;
        checkGreeting(greeting);
        rest = greeting.subarray(GREETING_SIZE);
        greeting = null;
        socket.write(Buffer.concat([frameHead(COMMAND, READY.length), READY]));
      }
      messages.receive(rest);
    };
  }

  /** @param {net.Socket} socket @param {string} name @param {Buffer} data */
  #command(socket, name, data) {
    if (name === "READY") {
      this.#ready = true;
      this.#events.connected();
    } else if (name === "PING") {
      // Two bytes of time to live, then a context that the PONG repeats.
      const pong = Buffer.concat([Buffer.from("\x04PONG", "latin1"), data.subarray(2)]);
      socket.write(Buffer.concat([frameHead(COMMAND, pong.length), pong]));
    } else if (name === "ERROR") {
      this.#events.log(`the hub ends the connection: ${data.toString("utf8", 1)}`);
      socket.destroy();
    }
  }
}

/** @param {string} hub @returns {net.NetConnectOpts} */
function optionsOf(hub) {
  if (hub.startsWith("ipc://") && hub.length > "ipc://".length) {
    const path = hub.slice("ipc://".length);
    const size = Buffer.byteLength(path);
    if (size > MAX_PATH) throw new ConfigError(`the path of a Unix socket has at most ${MAX_PATH} bytes, and ${path} has ${size}`);
    return { path };
  }
  const [, host, port] = /^tcp:\/\/(\[[^\]]+\]|[^:/]+):(\d+)$/.exec(hub) ?? [];
  if (host === undefined || Number(port) < 1 || Number(port) > 65535) {
    throw new ConfigError(`the address of a hub is like tcp://127.0.0.1:4097 or ipc:///tmp/hub, not ${JSON.stringify(hub)}`);
  }
  return { host: host.replace(/[[\]]/g, ""), port: Number(port), noDelay: true };
}
