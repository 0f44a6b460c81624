// The mirror, with which glue-conform judges this library: docs/clients.md says what it does.
//
// glue-conform agent -- node mirror.js agent        (or environment, experiment)

import { connect, GlueError, HubClosed, serveAgent, serveEnvironment } from "glue-rl";

/** @typedef {import("glue-rl").AbstractTypeLike} AbstractTypeLike */
/** @typedef {import("glue-rl").AbstractType} AbstractType */
/** @typedef {import("glue-rl").Observation} Observation */

const EMPTY = { ints: new Int32Array(), doubles: new Float64Array(), chars: new Uint8Array() };

/** An observation, with what is beside it behind its runs. @param {Observation} seen @returns {AbstractType} */
function shown({ ints, doubles, chars, mask = new Uint8Array(), extras = {} }) {
  const legal = [...mask.keys()].filter((i) => mask[i] === 1);
  const moreDoubles = [...doubles];
  const moreChars = [chars];
  for (const [name, extra] of Object.entries(extras).sort(([one], [other]) => (one < other ? -1 : 1))) {
    const numbers = typeof extra === "string" || extra instanceof Uint8Array ? [] : [extra].flat();
    const whole = numbers.every((number) => typeof number === "bigint" || Number.isInteger(number));
    if (!whole) moreDoubles.push(...numbers.map(Number));
    moreChars.push(Buffer.from(`\n${name}=${whole ? numbers.join(" ") : ""}`));
    if (typeof extra === "string") moreChars.push(Buffer.from(extra));
    if (extra instanceof Uint8Array) moreChars.push(extra);
  }
  return { ints: Int32Array.of(...ints, ...legal), doubles: Float64Array.from(moreDoubles), chars: Buffer.concat(moreChars) };
}

/** @param {ArrayLike<number>} ints */
const sum = (ints) => Array.from(ints).reduce((a, b) => a + b, 0);

class Mirror {
  count = 0;
  number = 0n;

  /** @param {bigint} seed */
  seed(seed) {
    this.number = seed;
  }

  /** @param {string} text */
  message(text) {
    if (text === "fail") throw new Error("asked to fail");
    return text;
  }

  save() {
    return Buffer.from(`${this.count} ${this.number}`);
  }

  /** @param {Uint8Array} data */
  load(data) {
    const [count, number] = Buffer.from(data).toString().split(" ");
    this.count = Number(count);
    this.number = BigInt(number);
  }

  /** @param {AbstractType} shown @param {number[]} more doubles @returns {AbstractTypeLike} */
  mirror({ ints, doubles, chars }, ...more) {
    if (ints.length + doubles.length + chars.length === 0) return {};
    return {
      ints: [...ints.slice().reverse(), this.count],
      doubles: [...doubles.slice().reverse(), sum(ints), ...more],
      chars: chars.slice().reverse(),
    };
  }
}

class MirrorAgent extends Mirror {
  /** @type {number[]} */
  #told = [];

  /** @param {number} deadline @param {number} latency */
  pace(deadline, latency) {
    this.#told = [deadline, latency];
  }

  init() {
    this.count = 0;
  }

  /** @param {Observation} observation */
  start(observation) {
    return this.step(0, observation);
  }

  /** @param {number} reward @param {Observation} observation */
  step(reward, observation) {
    this.count += 1;
    return this.mirror(shown(observation), reward, ...this.#told.splice(0));
  }

  end() {
    this.count += 1;
  }

  metrics() {
    return { count: this.count, "half the count": this.count / 2 };
  }
}

class MirrorEnvironment extends Mirror {
  init() {
    this.count = 0;
    return "a mirror, größer than it is";
  }

  start() {
    this.count += 1;
    return { ints: [this.count] };
  }

  /** @param {AbstractType} action */
  step(action) {
    this.count += 1;
    const { ints, doubles, chars } = action;
    const beside = chars.at(-1) === "&".charCodeAt(0) && {
      mask: ints.map((value) => Number(value !== 0)),
      extras: { count: this.count, half: this.count + 0.5, text: "größer", chars, ints, doubles },
    };
    return {
      reward: doubles[0] ?? 0,
      terminal: chars.at(-1) === "!".charCodeAt(0),
      truncated: chars.at(-1) === "?".charCodeAt(0),
      observation: { ...this.mirror(action), ...beside },
    };
  }
}

/** @param {Iterable<number>} ints @param {Iterable<number>} doubles @param {Uint8Array} chars @returns {AbstractTypeLike} */
function result(ints = [], doubles = [], chars = new Uint8Array()) {
  return { ints: [...ints], doubles: [...doubles, sum([...ints])], chars };
}

/** @param {Observation} observation @param {AbstractType} action @param {number[]} ints @param {number[]} doubles */
function both(observation, action, ints = [], doubles = []) {
  const seen = shown(observation);
  return result(
    [...seen.ints, ...action.ints, ...ints],
    [...seen.doubles, ...action.doubles, ...doubles],
    Buffer.concat([seen.chars, action.chars]),
  );
}

/** @param {string} text */
const words = (text) => result([], [], Buffer.from(text));

/**
 * What a verb returns.
 *
 * @param {import("glue-rl").Experiment} glue @param {string} verb @param {Buffer} argument @param {number} reward
 * @param {Observation} order @param {string[]} notices
 */
async function carryOut(glue, verb, argument, reward, { ints, doubles, mask }, notices) {
  const text = argument.toString();
  const given = { ints, doubles, chars: argument, mask };
  switch (verb) {
    case "RL_INIT": return words(await glue.init(text === "" ? undefined : BigInt(text)));
    case "RL_START": {
      const { observation, action } = await glue.start();
      return both(observation, action);
    }
    case "RL_STEP": {
      const { reward: gained, terminal, truncated, observation, action } = await glue.step();
      return both(observation, action, [truncated ? 2 : Number(terminal)], [gained]);
    }
    case "RL_EPISODE": return result([Number(await glue.episode(BigInt(text)))]);
    case "RL_RETURN": return result([], [await glue.episodeReturn()]);
    case "RL_NUM_STEPS": return words(String(await glue.numSteps()));
    case "RL_NUM_EPISODES": return words(String(await glue.numEpisodes()));
    case "RL_AGENT_MESSAGE": return words(await glue.agentMessage(text));
    case "RL_ENV_MESSAGE": return words(await glue.envMessage(text));
    case "RL_CLEANUP": await glue.cleanup(); return result();
    case "RL_ENV_START": return both(await glue.envStart(), EMPTY);
    case "RL_ENV_STEP": {
      const { reward: gained, terminal, truncated, observation } = await glue.envStep(given);
      return both(observation, EMPTY, [truncated ? 2 : Number(terminal)], [gained]);
    }
    case "RL_AGENT_START": return both(EMPTY, await glue.agentStart(given));
    case "RL_AGENT_STEP": return both(EMPTY, await glue.agentStep(reward, given));
    case "RL_AGENT_END": await glue.agentEnd(reward); return result();
    case "RL_AGENT_SAVE": return result([], [], await glue.agentSave());
    case "RL_ENV_SAVE": return result([], [], await glue.envSave());
    case "RL_AGENT_METRICS": {
      const metrics = await glue.agentMetrics();
      return result([], Object.values(metrics), Buffer.from(Object.keys(metrics).join("\n")));
    }
    case "RL_AGENT_LOAD": await glue.agentLoad(argument); return result();
    case "RL_ENV_LOAD": await glue.envLoad(argument); return result();
    case "notices": return words(notices.splice(0).join("\n"));
    default: throw new Error(`the mirror was ordered to do ${verb}, which it does not know`);
  }
}

async function mirrorExperiment() {
  /** @type {string[]} */
  const notices = [];
  const glue = await connect({ name: "mirror", onNotice: (event, role, name) => notices.push(`${event} ${role} ${name}`) });
  try {
    let shown = /** @type {AbstractTypeLike} */ ({ chars: Buffer.from("ready") });
    for (;;) {
      const { reward, observation: order } = await glue.envStep(shown);
      const chars = Buffer.from(order.chars);
      const space = chars.indexOf(" ");
      const verb = chars.subarray(0, space < 0 ? chars.length : space).toString();
      if (verb === "end") return;
      try {
        shown = await carryOut(glue, verb, chars.subarray(space < 0 ? chars.length : space + 1), reward, order, notices);
      } catch (error) {
        if (!(error instanceof GlueError) || error.code === undefined) throw error;
        shown = words(`ERROR ${error.code} ${error.message}`);
      }
    }
  } finally {
    await glue.close(); // an open connection would keep the program
  }
}

const roles = {
  agent: () => serveAgent(new MirrorAgent(), { name: "mirror" }),
  environment: () => serveEnvironment(new MirrorEnvironment(), { name: "mirror" }),
  experiment: mirrorExperiment,
};

try {
  const goodbye = await roles[/** @type {keyof typeof roles} */ (process.argv[2])]();
  if (goodbye !== undefined) console.log(goodbye);
} catch (error) {
  console.log(/** @type {Error} */ (error).message);
  process.exitCode = error instanceof HubClosed ? 0 : 1;
}
