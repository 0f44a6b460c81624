// One entrant: its attempts, why they ended, and replays of those that were verified.

import { count, failure, h, loading, score, setText, table } from "../dom.js";
import { load, watch } from "./data.js";
import { counts, figure, interval, moment, percent } from "./words.js";

const ROWS = 100; // of attempts, until more are asked for

export function mount(element, { path: [name = ""] }) {
  const title = h("h1", {}, name);
  const content = h("div", {}, loading());
  element.append(h("p", { class: "links" }, h("a", { class: "button", href: "#/board" }, "Board")), title, content);
  let ended = false;
  let all = false;

  const stop = watch(async (board) => {
    try {
      const found = await load(`entrants/${encodeURIComponent(name)}.json`);
      if (ended) return;
      setText(title, name === board.you ? `${name} (you)` : name);
      draw(found, board);
    } catch (error) {
      if (!ended) content.replaceChildren(failure(error));
    }
  });

  function draw(found, board) {
    const rows = all ? found.attempts : found.attempts.slice(0, ROWS);
    const more = found.attempts.length - rows.length;
    content.replaceChildren(
      h("dl", {}, ...facts(found).flatMap(([term, text]) => [h("dt", {}, term), h("dd", {}, text)])),
      figure(found.over_time, "Place over time") ?? "",
      attempts(name, rows, board),
      more > 0 ? h("p", {}, h("button", { type: "button", onclick: () => { all = true; draw(found, board); } }, `Show ${count(more)} more`)) : "");
  }
  return () => {
    ended = true;
    stop();
  };
}

function facts(found) {
  return [
    ["place", found.place === null ? "none yet" : `${found.place}`],
    ["score", `${score(found.score)}, 95 % interval ${interval(found)}`],
    ["attempts", counts(found.counts)],
    ["counts", found.counting.length ? found.counting.map((number) => `attempt ${number}`).join(", ") : "no attempt yet"],
    ["late actions", found.late === null ? "" : percent(found.late)],
    ["name", found.own],
    ["team", found.team],
    ["state", found.why],
  ].filter(([, text]) => text);
}

function attempts(name, rows, { replays }) {
  if (!rows.length) return h("p", { class: "empty" }, "There is no attempt yet.");
  return table("Attempts", ["attempt", "state", "score", "began", "ended", "why", "replay"], rows.map((one) => [
    `${one.attempt}`, one.counts ? h("strong", {}, `${one.state}, counts`) : one.state, score(one.score), moment(one.began),
    moment(one.ended), one.why, replays && one.replay
      ? h("a", { href: `#/replay/${encodeURIComponent(name)}/${one.attempt}` }, `Replay of attempt ${one.attempt}`) : ""]), true);
}
