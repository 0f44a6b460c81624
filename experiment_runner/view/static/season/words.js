// Words and numbers that the views of a season share.

import { drawing } from "../curves.js";
import { count, date, h, score } from "../dom.js";

/** Return the link to an entrant; `you` is the name of the one who looks on. */
export const entrantLink = (name, you) =>
  h("a", { href: `#/entrant/${encodeURIComponent(name)}` }, name === you ? `${name} (you)` : name);

/** Return an interval in words. */
export const interval = ({ low, high }) => (low === null || low === undefined ? "-" : `${score(low)} to ${score(high)}`);

/** Return an element with a time of the server, as in 2026-11-27T06:00:00Z, in the local time zone. */
export const moment = (time) => (time ? h("time", { datetime: time }, date(Date.parse(time) / 1000)) : "");

/** Return the numbers of an entrant's attempts, as in "5 verified, 2 forfeited, 1 ours". */
export const counts = (numbers) =>
  Object.entries(numbers).filter(([, number]) => number).map(([what, number]) => `${count(number)} ${what}`).join(", ") || "none";

/** Return a drawing with its legend, or null without one. */
export const figure = (found, label) => found && h("figure", { class: "card", role: "img", "aria-label": label },
  h("figcaption", {}, label), drawing(found.svg),
  h("ul", { class: "legend" }, ...found.legend.map(({ name, sample }) => h("li", {}, drawing(sample), " ", name))));
