// An agent that walks away from where it started, written from docs/protocol.md alone.
//
// Usage: node agent.mjs [tcp://127.0.0.1:4097] [session]

import { randomBytes } from "node:crypto";
import { pack, unpack } from "./msgpack.mjs";
import { Dealer } from "./zmtp.mjs";

const HELLO = 64, WELCOME = 65, REFUSE = 66, HEARTBEAT = 67, GOODBYE = 68, ERROR = 69;
const INIT = 4, START = 5, STEP = 6, END = 7, CLEANUP = 8, MESSAGE = 10;

// After receiving nothing for this long, a peer asks the hub whether it still knows it.
const SILENCE_MS = 1000;

const NOTHING = Buffer.alloc(0);

// The ints, doubles and chars of an observation or an action.
function read(body) {
  const view = new DataView(body.buffer, body.byteOffset, body.byteLength);
  const ints = view.getUint32(0, true);
  const doubles = view.getUint32(4, true);
  const chars = view.getUint32(8, true);
  const atInts = 16 + 8 * doubles;
  const atChars = atInts + 4 * ints;
  return {
    ints: Array.from({ length: ints }, (_, i) => view.getInt32(atInts + 4 * i, true)),
    doubles: Array.from({ length: doubles }, (_, i) => view.getFloat64(16 + 8 * i, true)),
    chars: body.subarray(atChars, atChars + chars),
  };
}

// The body of an observation or an action.
function write({ ints = [], doubles = [], chars = NOTHING }) {
  const head = Buffer.alloc(16 + 8 * doubles.length + 4 * ints.length);
  head.writeUInt32LE(ints.length, 0);
  head.writeUInt32LE(doubles.length, 4);
  head.writeUInt32LE(chars.length, 8);
  doubles.forEach((value, i) => head.writeDoubleLE(value, 16 + 8 * i));
  ints.forEach((value, i) => head.writeInt32LE(value, 16 + 8 * doubles.length + 4 * i));
  return Buffer.concat([head, chars]);
}

// Goes up (1) if its first int says that it is not below its start, else down (0).
class Walker {
  constructor() {
    this.forget();
  }

  forget() {
    this.start = 0;
    this.episodes = 0;
    this.total = 0;
    this.seen = write({});
  }

  act(observation) {
    this.seen = observation;
    return write({ ints: [read(observation).ints[0] >= this.start ? 1 : 0] });
  }

  describe() {
    const { ints, doubles, chars } = read(this.seen);
    const sum = doubles.reduce((a, b) => a + b, 0);
    return `${this.episodes} episodes, ${this.total} in all; last seen: ` +
      `${ints.length} ints, ${doubles.length} doubles that sum to ${sum}, ${chars.length} chars`;
  }

  // The body of the answer to a call: null where it has none, undefined where the call is unknown.
  answer(kind, scalars, body) {
    switch (kind) {
      case INIT:
        this.forget();
        return null;
      case START:
        this.start = read(body).ints[0];
        return this.act(body);
      case STEP:
        this.total += scalars[0];
        return this.act(body);
      case END:
        this.total += scalars[0];
        this.episodes += 1;
        return null;
      case CLEANUP:
        return null;
      case MESSAGE:
        return Buffer.from(this.describe(), "utf8");
      default:
        return undefined;
    }
  }
}

async function main(hub = "tcp://127.0.0.1:4097", session = "default") {
  const agent = new Walker();
  const socket = new Dealer();
  const hello = [pack([HELLO, session, 0, [1], "agent", randomBytes(16), "walker", "JavaScript, Node", []])];
  let lastSeq = 0;
  let lastCall = NOTHING;
  let lastAnswer = [];
  let welcomed = false;
  const greet = () => {
    welcomed = false;
    socket.send(hello);
  };
  socket.connect(hub, greet);
  for (;;) {
    const frames = await socket.receive(SILENCE_MS);
    if (frames === null) {
      if (welcomed) socket.send([pack([HEARTBEAT, session, 0])]);
      continue;
    }
    const call = Buffer.concat(frames);
    const [kind, , seq, ...scalars] = unpack(frames[0]);
    if (kind === WELCOME) {
      const [, resumed] = scalars;
      welcomed = true;
      if (!resumed) lastSeq = 0;
    } else if (kind === REFUSE) {
      console.error(`refused: ${scalars[1]}`);
      process.exit(1);
    } else if (kind === GOODBYE) {
      process.exit(0);
    } else if (kind === ERROR) {
      if (scalars[0] !== "unknown-peer") console.error(`the hub says: ${scalars[1]}`);
      else if (welcomed) greet();
    } else if (kind === HEARTBEAT || seq < lastSeq) {
      continue;
    } else if (call.equals(lastCall)) {
      socket.send(lastAnswer);
    } else {
      const body = agent.answer(kind, scalars, frames[1] ?? NOTHING);
      if (body === undefined) lastAnswer = [pack([ERROR, session, seq, "unknown-kind", `what is ${kind}?`])];
      else if (body === null) lastAnswer = [pack([kind, session, seq])];
      else lastAnswer = [pack([kind, session, seq]), body];
      lastSeq = seq;
      lastCall = call;
      socket.send(lastAnswer);
    }
  }
}

await main(...process.argv.slice(2));
