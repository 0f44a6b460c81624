// Every error of this library is a GlueError; its message names the cause and the remedy.

export class GlueError extends Error {
  /** @param {string} message @param {string} [code] of the ERROR or REFUSE */
  constructor(message, code) {
    super(message);
    this.name = new.target.name;
    this.code = code;
  }
}

export class ConfigError extends GlueError {}

export class ProtocolError extends GlueError {}

export class Refused extends GlueError {}

export class HubClosed extends GlueError {}

export class PeerLost extends GlueError {}

export class PeerFailed extends GlueError {}

export class Unsupported extends GlueError {}
