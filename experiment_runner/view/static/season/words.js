// Words and numbers that the views of a season share.

import { count, drawing, h, legend, score } from "../dom.js";

const TIME = { year: "numeric", month: "2-digit", day: "2-digit", hour: "2-digit", minute: "2-digit", timeZoneName: "short" };

/** Return the link to an entrant; `you` is the name of the viewer. */
export const entrantLink = (name, you) =>
  h("a", { href: `#/entrant/${encodeURIComponent(name)}` }, name === you ? `${name} (you)` : name);

/** Return a share in words. */
export const percent = (share) => `${(100 * share).toFixed(1)} %`;

/** Return an interval in words. */
export const interval = ({ low, high }) => (low === null || low === undefined ? "-" : `${score(low)} to ${score(high)}`);

/** Return an element with a time of the server, as in 2026-11-27T06:00:00Z, in the local time zone. */
export const moment = (time) => (time ? h("time", { datetime: time }, new Date(time).toLocaleString("sv", TIME)) : "");

/** Return the numbers of an entrant's attempts, as in "5 verified, 2 forfeited, 1 ours". */
export const counts = (numbers) =>
  Object.entries(numbers).filter(([, number]) => number).map(([what, number]) => `${count(number)} ${what}`).join(", ") || "none";

/** Return a drawing with its legend, or null without one. */
export const figure = (found, label) => found && h("figure", { class: "card" }, h("figcaption", {}, label),
  ...["narrow", "wide"].map((size) => h("div", { class: size }, drawing(found[size], label))), legend(found.legend));
