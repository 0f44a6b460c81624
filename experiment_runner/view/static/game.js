// The game: the list of a run's recorded episodes, and the player of one episode.

import { count, failure, get, h, loading, score, setText, table } from "./dom.js";
import { showEpisode } from "./game/episode.js";
import { watchLive } from "./game/live.js";
import { listen } from "./stream.js";

const ROWS = 50;

export async function mount(element, { path: [run = "", episode = ""], query }) {
  const title = h("h1", {}, "Game");
  const links = h("p", { class: "links" }, h("a", { class: "button", href: `#/run/${encodeURIComponent(run)}` }, "Run"));
  element.append(title, links);
  const stops = [listen("runs", (changed, all) => {
    const name = all.get(run)?.name ?? "There is no such run any more.";
    setText(title, episode ? `${name}: episode ${episode}` : name);
  })];
  if (episode) links.append(h("a", { class: "button", href: `#/game/${encodeURIComponent(run)}` }, "All episodes"));
  try {
    const place = `${encodeURIComponent(run)}/${encodeURIComponent(episode)}`;
    if (episode) stops.push(await showEpisode(element, links, `api/episodes/${place}`, `#/game/${place}`, query));
    else {
      stops.push(watchLive(element, run));
      await mountList(element, run);
    }
  } catch (error) {
    element.append(failure(error));
  }
  return () => stops.forEach((stop) => stop());
}

async function mountList(element, run) {
  const wait = loading();
  element.append(wait);
  const recordings = await get(`recordings/${encodeURIComponent(run)}`).finally(() => wait.remove());
  element.append(h("h2", {}, "Recorded episodes"));
  if (!recordings.length) {
    element.append(h("p", { class: "empty" }, "This run has no recording. ",
      h("code", {}, "glue-experiment --out DIR --record DIR/run.traj"), " makes one: the page shows every file *.traj in the run's folder."));
  }
  for (const recording of recordings) element.append(...listed(run, recording));
}

function listed(run, recording) {
  const parts = [];
  if (recording.error) parts.push(failure(recording.error));
  const episodes = recording.episodes;
  const box = h("div");
  const id = (number) => `${recording.id ? `${recording.id}-` : ""}${number}`;
  const fill = (first) => {
    const rows = episodes.slice(first, first + ROWS).map(([steps, total, ending], i) => [
      h("a", { href: `#/game/${encodeURIComponent(run)}/${id(first + i + 1)}` }, `Episode ${count(first + i + 1)}`),
      score(Number(total)), count(steps), ending === "cutoff" ? "cut off" : ending]);
    const more = (label, to, isThere) => h("button", { type: "button", disabled: !isThere, onclick: () => fill(to) }, label);
    box.replaceChildren(table(recording.name, ["episode", "return", "steps", "end"], rows));
    if (episodes.length > ROWS) {
      box.append(h("p", { class: "controls" }, more("Earlier", first - ROWS, first > 0), more("Later", first + ROWS, first + ROWS < episodes.length),
        h("span", { class: "quiet" }, `${count(first + 1)} to ${count(first + rows.length)} of ${count(episodes.length)}`)));
    }
  };
  if (episodes.length) {
    fill(0);
    parts.push(box);
  } else if (!recording.error) {
    parts.push(h("p", { class: "empty" }, `${recording.name} holds no whole episode yet.`));
  }
  if (recording.more) parts.push(h("p", { class: "quiet" }, "It holds more, which are too many for this page: glue-replay shows them."));
  return parts;
}
