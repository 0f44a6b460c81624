// A DEALER over plain TCP: ZMTP 3.1 with the NULL mechanism, as the appendix of docs/protocol.md says.
// The npm package `zeromq` does the same and much more; this shows that it can be done without.

import net from "node:net";

const MORE = 1, LONG = 2, COMMAND = 4;
const GREETING_SIZE = 64;
const RECONNECT_MS = 100;

// The hub sends a heartbeat every second; a connection without any for this long is dead.
const TIMEOUT_MS = 5000;

const GREETING = Buffer.alloc(GREETING_SIZE);
GREETING.set([0xff, 0, 0, 0, 0, 0, 0, 0, 0, 0x7f, 3, 1]);
GREETING.write("NULL", 12, "ascii");

const READY = Buffer.from("\x05READY\x0bSocket-Type\0\0\0\x06DEALER\x08Identity\0\0\0\0", "latin1");

export class Dealer {
  #address;
  #socket = null;
  #received = [];
  #waiting = null;
  #onConnection = () => {};

  // `onConnection` is called whenever there is a new connection, which the hub does not know yet.
  connect(url, onConnection) {
    this.#onConnection = onConnection;
    const { hostname, port } = new URL(url.replace("tcp:", "http:"));
    this.#address = { host: hostname.replace(/[[\]]/g, ""), port: Number(port), noDelay: true };
    this.#run();
  }

  // Send a message. Without a connection it is lost, as it is when a connection breaks: the hub asks again.
  send(frames) {
    const parts = frames.map((part, i) => frame(i < frames.length - 1 ? MORE : 0, part));
    this.#socket?.write(Buffer.concat(parts));
  }

  // Return the frames of the next message, or null if none comes within `timeout` milliseconds.
  async receive(timeout) {
    if (this.#received.length === 0) {
      await new Promise((resolve) => {
        const timer = setTimeout(resolve, timeout);
        this.#waiting = () => {
          clearTimeout(timer);
          resolve();
        };
      });
      this.#waiting = null;
    }
    return this.#received.shift() ?? null;
  }

  async #run() {
    for (;;) {
      await this.#connection();
      this.#socket = null;
      await new Promise((resolve) => setTimeout(resolve, RECONNECT_MS));
    }
  }

  // Return when a connection, or the attempt to make one, is over.
  #connection() {
    return new Promise((resolve) => {
      const socket = net.connect(this.#address);
      const read = this.#reader(socket);
      const dead = setTimeout(() => socket.destroy(), TIMEOUT_MS);
      socket.on("connect", () => socket.write(GREETING));
      socket.on("data", (chunk) => {
        dead.refresh();
        read(chunk);
      });
      socket.on("error", () => {}); // "close" follows.
      socket.on("close", () => {
        clearTimeout(dead);
        resolve();
      });
    });
  }

  // Return a function that takes bytes as they come: the greeting of the other side, then its frames.
  #reader(socket) {
    let buffer = Buffer.alloc(0);
    let greeted = false;
    let message = [];

    return (chunk) => {
      buffer = Buffer.concat([buffer, chunk]);
      if (!greeted && buffer.length >= GREETING_SIZE) {
        greeted = true;
        buffer = buffer.subarray(GREETING_SIZE);
        socket.write(frame(COMMAND, READY));
      }
      while (greeted && buffer.length >= 2) {
        const flags = buffer[0];
        const start = flags & LONG ? 9 : 2;
        if (buffer.length < start) return;
        const size = flags & LONG ? Number(buffer.readBigUInt64BE(1)) : buffer[1];
        if (buffer.length < start + size) return;
        const body = buffer.subarray(start, start + size);
        buffer = buffer.subarray(start + size);
        if (flags & COMMAND) {
          this.#command(socket, body);
        } else {
          message.push(body);
          if (!(flags & MORE)) {
            this.#received.push(message);
            message = [];
            this.#waiting?.();
          }
        }
      }
    };
  }

  #command(socket, body) {
    const name = body.toString("latin1", 1, 1 + body[0]);
    if (name === "READY") {
      this.#socket = socket;
      this.#onConnection();
    } else if (name === "PING") {
      // After the name come two bytes of time to live, then a context that the PONG repeats.
      socket.write(frame(COMMAND, Buffer.concat([Buffer.from("\x04PONG", "latin1"), body.subarray(7)])));
    } else if (name === "ERROR") {
      socket.destroy();
    }
  }
}

function frame(flags, body) {
  if (body.length < 256) return Buffer.concat([Buffer.from([flags, body.length]), body]);
  const head = Buffer.alloc(9);
  head[0] = flags | LONG;
  head.writeBigUInt64BE(BigInt(body.length), 1);
  return Buffer.concat([head, body]);
}
