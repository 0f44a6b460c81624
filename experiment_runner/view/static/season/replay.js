// A verified attempt, played again by its environment: the list of its episodes, and one of them with the game's picture.

import { count, failure, h, loading, score, table } from "../dom.js";
import { showEpisode } from "../game/episode.js";
import { load } from "./data.js";

export async function mount(element, { path: [name = "", attempt = "", ...where], query }) {
  const place = [name, attempt].map(encodeURIComponent).join("/");
  const title = `${name}, attempt ${attempt}`;
  const links = h("p", { class: "links" }, h("a", { class: "button", href: `#/entrant/${encodeURIComponent(name)}` }, name));
  element.append(h("h1", {}, where.length ? `${title}: ${where.join(", ")}` : title), links);
  try {
    if (!where.length) return await mountList(element, place);
    links.append(h("a", { class: "button", href: `#/replay/${place}` }, "All episodes"));
    const episode = `${place}/${where.map(encodeURIComponent).join("/")}`;
    return await showEpisode(element, links, `replays/${episode}`, `#/replay/${episode}`, query);
  } catch (error) {
    element.append(failure(error));
    return () => {};
  }
}

async function mountList(element, place) {
  const wait = loading();
  element.append(wait);
  const trials = await load(`replays/${place}.json`).finally(() => wait.remove());
  for (const { task, trial, episodes, more } of trials) {
    element.append(table(`${task}, trial ${trial}`, ["episode", "return", "steps", "end"], episodes.map(([steps, total, ending], i) => [
      h("a", { href: `#/replay/${place}/${encodeURIComponent(task)}/${trial}/${i + 1}` }, `Episode ${count(i + 1)}`),
      score(Number(total)), count(steps), ending === "cutoff" ? "cut off" : ending])));
    if (more) element.append(h("p", { class: "quiet" }, "It has more episodes, which are too many for this page."));
  }
  return () => {};
}
