// The board: places, what plays and what waits, announcements and rules.

import { count, h, loading, score, setText, table } from "../dom.js";
import { projector } from "../projector.js";
import { watch } from "./data.js";
import { counts, entrantLink, figure, interval, moment, percent } from "./words.js";

const ROWS = 100; // of the table, until more are asked for
const WAITING = 20; // that are listed

export function mount(element, { query }) {
  const title = h("h1", {}, "Season");
  const state = h("p", { class: "quiet", role: "status" });
  const content = h("div", {}, loading());
  let all = false;
  let known = null;
  let isLarge = false;
  const large = projector("#/board", query, (next) => {
    isLarge = next;
    if (known) draw(known);
  });
  element.append(h("div", { class: "head" }, title, large.button), state, content);

  const stop = watch(draw);

  function draw(board) {
    known = board;
    setText(title, board.season);
    setText(state, board.state);
    const rows = all ? board.entrants : board.entrants.slice(0, ROWS);
    const more = board.entrants.length - rows.length;
    content.replaceChildren(...announcements(board), ...you(board), places(board, rows, isLarge),
      more > 0 ? h("p", {}, h("button", { type: "button", onclick: () => { all = true; draw(board); } }, `Show ${count(more)} more`)) : "",
      ...queue(board), figure(board.over_time, "Places over time") ?? "",
      ...list("What the organiser did", board.acts), ...list("Rules", board.rules));
  }
  return () => {
    stop();
    large.close();
  };
}

/** Return the table of places; the enlarged one has only the columns that can be read from afar. */
function places(board, rows, isLarge) {
  if (!rows.length) return h("p", { class: "empty" }, "Nobody has enrolled yet.");
  const columns = ["place", "entrant", "score", "95 % interval", "not separated from place"];
  const timed = rows.some((one) => one.late !== null);
  const more = isLarge ? [] : ["attempt that counts", "attempts", ...board.tasks, ...(timed ? ["late actions"] : [])];
  return table("Places", [...columns, ...more], rows.map((one) => [
    one.place === null ? "-" : `${one.place}`, name(one, board.you), score(one.score), interval(one), one.tied === null ? "-" : `${one.tied}`,
    one.counting.length === 1 ? `${one.counting[0]}` : one.counting.length ? `all ${count(one.counting.length)}` : "-",
    counts(one.counts), ...board.tasks.map((task) => score(one.tasks[task])),
    one.late === null ? "-" : percent(one.late)].slice(0, columns.length + more.length)), true);
}

function name(one, you) {
  const link = entrantLink(one.name, you);
  const notes = [one.own, one.team, one.why].filter(Boolean);
  return notes.length ? h("span", {}, link, " ", h("span", { class: "quiet" }, notes.join("; "))) : link;
}

function announcements({ announcements: found }) {
  if (!found.length) return [];
  return [h("h2", {}, "Announcements"), h("ul", { class: "announcements" },
    ...found.map(({ time, text }) => h("li", {}, moment(time), " ", text)))];
}

function you({ you: name, entrants, waiting, left }) {
  const mine = entrants.find((one) => one.name === name);
  if (!mine) return [];
  const place = waiting.indexOf(name);
  return [h("p", { class: "card" }, "You are ", entrantLink(name, ""), mine.place === null ? ", without a place yet. " : `, place ${mine.place}. `,
    place < 0 ? "" : `Your next attempt is number ${place + 1} in the queue. `, left)];
}

const list = (title, lines) => (lines.length ? [h("h2", {}, title), h("ul", {}, ...lines.map((line) => h("li", {}, line)))] : []);

function queue({ playing, waiting, you: name }) {
  const parts = [h("h2", {}, "Now")];
  if (playing.length) {
    parts.push(table("Playing", ["entrant", "attempt", "since"],
      playing.map((one) => [entrantLink(one.name, name), `${one.attempt}`, moment(one.since)])));
  } else {
    parts.push(h("p", { class: "quiet" }, "Nothing plays."));
  }
  if (waiting.length) {
    const more = waiting.length - WAITING;
    parts.push(h("h3", {}, "Waiting"), h("ol", {}, ...waiting.slice(0, WAITING).map((one) => h("li", {}, entrantLink(one, name)))),
      more > 0 ? h("p", { class: "quiet" }, `and ${count(more)} more`) : "");
  }
  return parts;
}
