// RL-Glue for JavaScript: agents, environments and experiments as programs of their own.

export * from "./errors.js";
export { legal } from "./body.js";
export { connect } from "./experiment.js";
export { serveAgent, serveEnvironment } from "./players.js";
