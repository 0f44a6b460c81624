// The page's only stream of events: the topics that have listeners, and their current values.

const QUIET_SECONDS = 40; // the server sends at least every 15
const RETRY_SECONDS = 3;

const listeners = new Map(); // topic -> set of handlers
const values = new Map(); // topic -> Map of key -> value, or null if there is no such topic
const watchers = new Set(); // of the state of the connection

let source = null;
let topics = "";
let last = ""; // id of the last event
let state = "connecting";
let heard = 0;
let planned = false;

/**
 * Listen to a topic, such as "runs" or "live:ID".
 *
 * `handler(changed, all)` is called with an object of the changed values by key, where null marks a removed
 * value, and with a Map of all values; both are null if there is no such topic. It is called at once with the
 * known values. Returns a function that stops listening.
 */
export function listen(topic, handler) {
  if (!listeners.has(topic)) listeners.set(topic, new Set());
  listeners.get(topic).add(handler);
  const known = values.get(topic);
  if (known) handler(Object.fromEntries(known), known);
  reconnect();
  return () => {
    const handlers = listeners.get(topic);
    handlers?.delete(handler);
    if (handlers?.size === 0) {
      listeners.delete(topic);
      reconnect();
    }
  };
}

/** Call `watcher` with the state, "live", "connecting" or "lost", now and whenever it changes. */
export function watchConnection(watcher) {
  watchers.add(watcher);
  watcher(state);
}

function reconnect() {
  if (planned) return;
  planned = true;
  queueMicrotask(() => {
    planned = false;
    connect();
  });
}

function connect() {
  const wanted = [...listeners.keys()].sort();
  // A hidden tab closes its connection: a browser has only six per server.
  const names = document.hidden ? "" : wanted.map((name) => `topic=${encodeURIComponent(name)}`).join("&");
  if (source && names === topics && source.readyState !== EventSource.CLOSED) return;
  source?.close();
  source = null;
  if (!names) {
    topics = "";
    return;
  }
  for (const topic of values.keys()) if (!listeners.has(topic)) values.delete(topic);
  // A topic without known values must be sent from the beginning.
  const since = wanted.every((topic) => values.has(topic)) ? last : "";
  topics = names;
  source = new EventSource(`api/stream?${names}&since=${encodeURIComponent(since)}`);
  source.onopen = () => say("live");
  source.onmessage = receive;
  source.onerror = () => {
    say(source?.readyState === EventSource.CLOSED ? "lost" : "connecting");
  };
  heard = Date.now();
}

function receive(event) {
  const before = last.split("-")[0];
  last = event.lastEventId;
  heard = Date.now();
  // A new server at the same address sends everything again.
  if (before && before !== last.split("-")[0]) values.clear();
  for (const [topic, changed] of Object.entries(JSON.parse(event.data))) {
    if (!listeners.has(topic)) continue;
    let all = null;
    if (changed !== null) {
      all = values.get(topic) ?? new Map();
      for (const [key, value] of Object.entries(changed)) {
        if (value === null) all.delete(key);
        else all.set(key, value);
      }
      values.set(topic, all);
    }
    for (const handler of [...listeners.get(topic)]) handler(changed, all);
  }
}

function say(next) {
  if (next === state) return;
  state = next;
  for (const watcher of watchers) watcher(state);
}

document.addEventListener("visibilitychange", connect);
window.addEventListener("online", connect);
setInterval(() => {
  if (document.hidden || !listeners.size) return;
  // After sleep a connection can look alive although the other end has dropped it.
  const silent = Date.now() - heard > QUIET_SECONDS * 1000;
  if (source && source.readyState !== EventSource.CLOSED && !silent) return;
  source?.close();
  connect();
}, RETRY_SECONDS * 1000);
