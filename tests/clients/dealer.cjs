// An agent on zeromq.js: a DEALER of libzmq in Node. Usage: node dealer.cjs HUB FOLDER, where FOLDER has node_modules.
// It does what the agent of docs/examples does, once greeted.

const { createRequire } = require("node:module");
const { randomBytes } = require("node:crypto");
const path = require("node:path");

const [hub, folder] = process.argv.slice(2);
const zeromq = createRequire(path.join(folder, "package.json"))("zeromq");

async function main() {
  const { encode, decode, HELLO, GOODBYE, AGENT } = await import("../../clients/javascript/src/messages.js");
  const dealer = new zeromq.Dealer({ linger: 0 });
  dealer.connect(hub);
  const hello = [[1], "agent", randomBytes(16), "Dealer", "zeromq.js", []];
  await dealer.send(encode(HELLO, "default", 1, hello));
  let first = 0;
  let steps = 0;
  const act = (observation) => ({ ints: [observation.ints[0] >= first ? 1 : 0] });
  for await (const frames of dealer) {
    const { kind, session, seq, value } = decode(frames[0], frames[1]);
    if (kind === GOODBYE) break;
    if (kind === AGENT.START) first = value.ints[0];
    if (kind === AGENT.STEP) steps += 1;
    const answers = {
      [AGENT.INIT]: undefined,
      [AGENT.START]: () => act(value),
      [AGENT.STEP]: () => act(value),
      [AGENT.END]: undefined,
      [AGENT.CLEANUP]: undefined,
      [AGENT.MESSAGE]: () => `${steps} steps`,
    };
    if (kind in answers) await dealer.send(encode(kind, session, seq, [], answers[kind]?.()));
  }
  dealer.close();
}

main();
