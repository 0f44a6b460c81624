// One recorded episode: its screen, its player, and a link to the moment that is shown.

import { h } from "../dom.js";
import { play } from "./player.js";
import { Recording } from "./recording.js";
import { Screen } from "./screen.js";

/** Show the episode at `source` in `element`; `view` is the view's address. Returns a function that ends it. */
export async function showEpisode(element, links, source, view, query) {
  const response = await fetch(source);
  if (!response.ok) throw new Error((await response.json()).error);
  const recording = new Recording(await response.arrayBuffer());
  const screen = await Screen.open(recording.about.spec);
  const address = (step) => `${view}?step=${step}`;
  const link = h("a", {}, "Link to this moment");
  const wanted = Number.parseInt(query.get("step") ?? "0", 10) || 0;
  const moved = (step) => {
    link.setAttribute("href", address(step));
    history.replaceState(null, "", address(step));
  };
  link.setAttribute("href", address(wanted));
  links.append(link, h("span", { class: "quiet" }, `${recording.about.recording}, episode ${recording.about.episode}`));
  element.append(screen.element);
  const player = play(screen, recording, wanted, moved);
  screen.below.append(player.element);
  return () => {
    player.close();
    screen.close();
  };
}
