/** RL-Glue for JavaScript: agents, environments and experiments as programs of their own. */

/** RL-Glue's abstract type, which observations and actions are: three runs of numbers, each of any length. */
export interface AbstractType {
  /** 32-bit integers. */
  readonly ints: Int32Array;
  readonly doubles: Float64Array;
  /** Bytes. */
  readonly chars: Uint8Array;
}

/** What can be sent as an action; a run that is left out is empty. */
export interface AbstractTypeLike {
  /** Integers from -2^31 to 2^31 - 1; any other is a RangeError. */
  readonly ints?: ArrayLike<number>;
  readonly doubles?: ArrayLike<number>;
  readonly chars?: Uint8Array;
}

export type Action = AbstractType;
export type ActionLike = AbstractTypeLike;

/** An observation, and what is beside it. */
export interface Observation extends AbstractType {
  /**
   * Which values of the next action are legal (1) and which are not (0), as `legal` numbers them, filled up with 0 to a
   * multiple of 8; undefined if all are.
   */
  readonly mask?: Uint8Array;
  /** Named values for everyone but the agent, whose observations have none; an int beyond 2^53 is a bigint. */
  readonly extras?: Readonly<Record<string, Extra>>;
}

/** What can be sent as an observation. */
export interface ObservationLike extends AbstractTypeLike {
  /** Which values of the next action are legal. An environment with masks has the word `masks` in its task spec's EXTRA. */
  readonly mask?: ArrayLike<boolean | number>;
  /** At most 64, with names of 1 to 64 printable characters, and 65,535 bytes in all. */
  readonly extras?: Readonly<Record<string, ExtraLike>>;
}

/** A number, a text, bytes, or an array of numbers, in which bigints and other whole numbers are ints. */
export type Extra = number | bigint | string | Uint8Array | (number | bigint)[];

/** What can be sent as an extra; Float64Array and Float32Array are floats even if all are whole. */
export type ExtraLike = Extra | ArrayLike<number> | ArrayLike<bigint>;

/**
 * Whether a value of the next action is legal: all are, unless there is a mask. The values of its ints are numbered from 0,
 * one int after another, each from its minimum: after an int from 0 to 2, 3 is the minimum of the next.
 */
export function legal(observation: Observation, value: number): boolean;

/** What the methods of players may return: a value, or a promise of one. */
export type Awaitable<T> = T | Promise<T>;

/**
 * An agent: it learns. With the method `seed` it offers the capability of that name, with `save` and `load` the
 * capability `save`, with `metrics` or `pace` the capability of that name.
 */
export interface Agent {
  /** Prepare for a task: forget what was learned before. */
  init(taskSpec: string): Awaitable<void>;
  /** The first observation of an episode; returns the first action. */
  start(observation: Observation): Awaitable<ActionLike>;
  /** The reward of the last action and the observation after it; returns the next action. */
  step(reward: number, observation: Observation): Awaitable<ActionLike>;
  /** The last reward of an episode that has reached its end. */
  end?(reward: number): Awaitable<void>;
  cleanup?(): Awaitable<void>;
  /** Answers a text with a text. Without this method the answer is empty. */
  message?(text: string): Awaitable<string>;
  /** Draw all random choices from this number from now on; 0 to 2^63 - 1. */
  seed?(seed: bigint): Awaitable<void>;
  /** Everything that later episodes depend on. */
  save?(): Awaitable<Uint8Array>;
  /** Go on from what `save` returned; check it, it may come from someone else. */
  load?(data: Uint8Array): Awaitable<void>;
  /** The agent's own numbers by name, such as its step size; asking changes nothing. */
  metrics?(): Awaitable<Readonly<Record<string, number>>>;
  /**
   * Before a `step` in an environment that does not wait: the seconds until its next step, and those that the last answer
   * took.
   */
  pace?(deadline: number, latency: number): void;
}

/** The outcome of an action. */
export interface Step<T = ObservationLike> {
  reward: number;
  /** Whether the episode is over. */
  terminal: boolean;
  observation: T;
  /** Whether it was only cut off, in a state that is not terminal: the agent is shown the observation, and no end. */
  truncated?: boolean;
}

/** An environment: the task. Its optional methods are those of an agent. */
export interface Environment {
  /** Prepare; returns the task spec. */
  init(): Awaitable<string>;
  /** Begin an episode; returns its first observation. */
  start(): Awaitable<ObservationLike>;
  step(action: Action): Awaitable<Step>;
  cleanup?(): Awaitable<void>;
  message?(text: string): Awaitable<string>;
  seed?(seed: bigint): Awaitable<void>;
  save?(): Awaitable<Uint8Array>;
  load?(data: Uint8Array): Awaitable<void>;
}

export interface Options {
  /** The hub's address; by default that of the environment variable GLUE_HUB, or tcp://127.0.0.1:4097. */
  hub?: string;
  /** The session's name; by default that of the environment variable GLUE_SESSION, or "default". */
  session?: string;
  /** What people see; by default the name of the player's class. */
  name?: string;
  /** Receives lines for people; by default they go to standard error. */
  log?: (line: string) => void;
}

/**
 * Take part in a session until the hub says goodbye, and resolve to its reason. A hub that is not there yet is waited
 * for; a connection that breaks is made again, and the episode goes on.
 *
 * Rejects with ConfigError, Refused, ProtocolError, or with what a method of the player threw, of which the hub is
 * informed.
 */
export function serveAgent(agent: Agent, options?: Options): Promise<string>;

/** As `serveAgent`. */
export function serveEnvironment(environment: Environment, options?: Options): Promise<string>;

export interface ExperimentOptions extends Options {
  /**
   * Called when a player `joined`, was `lost`, has `returned` or is `slow`; `name` is for people.
   */
  onNotice?: (event: string, role: string, name: string) => void;
}

/** Join a session as its experiment. Rejects with ConfigError, Refused, HubClosed or ProtocolError. */
export function connect(options?: ExperimentOptions): Promise<Experiment>;

/**
 * RL-Glue's verbs. Each waits for the players, and rejects with PeerLost, PeerFailed, Unsupported or HubClosed; only
 * one may be under way.
 */
export interface Experiment {
  /** RL_init; resolves to the task spec. With a seed (0 to 2^63 - 1), both players are seeded from it. */
  init(seed?: number | bigint): Promise<string>;
  start(): Promise<{ observation: Observation; action: Action }>;
  step(): Promise<Step<Observation> & { action: Action }>;
  /** RL_episode; at most `maxSteps` steps, 0 for any number. Resolves to whether it reached its end, and was not cut off. */
  episode(maxSteps?: number | bigint): Promise<boolean>;
  /** RL_return: the sum of the episode's rewards. */
  episodeReturn(): Promise<number>;
  numSteps(): Promise<bigint>;
  numEpisodes(): Promise<bigint>;
  agentMessage(text: string): Promise<string>;
  envMessage(text: string): Promise<string>;
  cleanup(): Promise<void>;

  envStart(): Promise<Observation>;
  envStep(action: ActionLike): Promise<Step<Observation>>;
  agentStart(observation: ObservationLike): Promise<Action>;
  agentStep(reward: number, observation: ObservationLike): Promise<Action>;
  agentEnd(reward: number): Promise<void>;

  agentSave(): Promise<Uint8Array>;
  agentLoad(data: Uint8Array): Promise<void>;
  /** The agent's own numbers by name. */
  agentMetrics(): Promise<Record<string, number>>;
  envSave(): Promise<Uint8Array>;
  envLoad(data: Uint8Array): Promise<void>;

  /** Say goodbye to the hub, and leave. */
  close(reason?: string): Promise<void>;
}

/** The base class of this library's errors. */
export class GlueError extends Error {
  /** The code of the hub's ERROR or REFUSE, such as "peer-lost", if this error stands for one. */
  readonly code?: string;
}

/** An address, a session's name or the environment is wrong. */
export class ConfigError extends GlueError {}

/** The program at the other end broke the protocol. */
export class ProtocolError extends GlueError {}

/** The hub refuses this program. */
export class Refused extends GlueError {}

/** The hub ended the session, or knows nothing of this experiment any more. */
export class HubClosed extends GlueError {}

/** A player was lost, and the episode is void: start another. The hub waits for the player, or for another. */
export class PeerLost extends GlueError {}

/** A player failed in a call, or broke the protocol. */
export class PeerFailed extends GlueError {}

/** The player lacks the capability for this request. */
export class Unsupported extends GlueError {}
