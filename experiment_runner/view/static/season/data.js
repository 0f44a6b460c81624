// The board, asked for again and again: it is one file, wherever the page is served from.

const SECONDS = 5;
const MOST_SECONDS = 60; // between two questions to a server that has asked for patience

const handlers = new Set();
const watchers = new Set();
let text = "";
let board = null;
let state = "connecting";
let timer = null;

/** Call `handler` with the board, now if it is known, and whenever it changes; returns a function that stops it. */
export function watch(handler) {
  handlers.add(handler);
  if (board) handler(board);
  return () => handlers.delete(handler);
}

/** Call `watcher` with the state, "live", "connecting" or "lost", now and whenever it changes. */
export function watchConnection(watcher) {
  watchers.add(watcher);
  watcher(state);
}

/** Return a file of the season as JSON; throws an `Error` that says what is wrong. */
export async function load(path) {
  const response = await fetch(path, { cache: "no-cache" }).catch(() => {
    throw new Error("The server does not answer.");
  });
  if (response.ok) return response.json();
  const type = response.headers.get("Content-Type") ?? "";
  throw new Error(type.startsWith("application/json") ? (await response.json()).error : `There is nothing here (${response.status}).`);
}

async function ask() {
  timer = null;
  let wait = SECONDS;
  try {
    const response = await fetch("season.json", { cache: "no-cache" });
    wait = Math.min(Math.max(Number(response.headers.get("Retry-After")) || 0, SECONDS), MOST_SECONDS);
    if (!response.ok) throw new Error(response.statusText);
    const found = await response.text();
    say("live");
    if (found !== text) {
      board = JSON.parse(found);
      text = found;
      for (const handler of [...handlers]) handler(board);
    }
  } catch {
    say("lost");
  }
  if (!document.hidden) timer ??= setTimeout(ask, wait * 1000);
}

function say(next) {
  if (next === state) return;
  state = next;
  for (const watcher of watchers) watcher(state);
}

document.addEventListener("visibilitychange", () => {
  clearTimeout(timer);
  timer = null;
  if (!document.hidden) ask();
});
ask();
