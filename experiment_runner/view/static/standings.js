// The live standings of a competition, also enlarged for a lecture hall.

import { count, drawing, failure, get, h, legend, loading, score, setText, table } from "./dom.js";
import { projector } from "./projector.js";
import { listen } from "./stream.js";

const REFRESH_SECONDS = 3;

export function mount(element, { path, query }) {
  const id = path[0] ?? "";
  const title = h("h1", {}, "Standings");
  const how = h("p", { class: "quiet", role: "status" });
  const content = h("div", {}, loading());
  const large = projector(`#/standings/${id}`, query);
  element.append(h("div", { class: "head" }, title, large.button), how, content);

  let run = null;
  let drawn = false;
  let timer = null;
  let ended = false;
  async function refresh() {
    timer = null;
    try {
      const board = await get(`standings/${encodeURIComponent(id)}`);
      if (ended) return;
      setText(title, board.competition);
      const { verified, mismatched } = run;
      setText(how, `${count(board.over)} of ${count(board.matches)} trials are over, ${count(verified)} verified${
        mismatched ? `; ${count(mismatched)} do not match their record` : ""}`);
      content.replaceChildren(...draw(board));
      drawn = true;
    } catch (error) {
      if (!ended) content.replaceChildren(failure(error));
    }
  }
  const stop = listen("runs", (changed, all) => {
    run = all.get(id);
    if (!run) content.replaceChildren(failure("There is no such competition any more."));
    else if (id in changed) timer ??= setTimeout(refresh, drawn ? REFRESH_SECONDS * 1000 : 0);
  });
  return () => {
    ended = true;
    stop();
    clearTimeout(timer);
    large.close();
  };
}

function draw(board) {
  const placed = board.entrants.filter((one) => one.place !== null);
  const parts = [];
  if (placed.length) {
    parts.push(table("Places", ["place", "entrant", "mean rank", "total", "95 % interval", "by total", ...board.tasks],
      placed.map((one) => [`${one.place}`, one.name, score(one.mean_rank), score(one.total),
        one.low === null ? "-" : `${score(one.low)} to ${score(one.high)}`, `${one.place_by_total}`,
        ...board.tasks.map((task) => `${score(one.tasks[task].score)} (${one.tasks[task].rank})`)])));
  } else {
    parts.push(h("p", { class: "empty" }, "Nobody has a place yet: a place takes a verified score in every trial. ",
      h("code", {}, "glue-compete verify DIR"), " verifies what is over."));
  }
  const missing = board.entrants.filter((one) => one.missing);
  if (missing.length) parts.push(table("Without a place", ["entrant", "why"], missing.map((one) => [one.name, one.missing])));
  const forfeits = board.entrants.flatMap((one) => one.forfeits.map((lost) => [one.name, lost.task, `${lost.trial}`, lost.reason]));
  if (forfeits.length) parts.push(table("Forfeits", ["entrant", "task", "trial", "reason"], forfeits));
  parts.push(h("div", { class: "figures" }, ...board.figures.map((one) => h("figure", { class: "card" },
    h("figcaption", {}, one.task), drawing(one.svg, `Learning curves of ${one.task}`), legend(one.legend)))));
  parts.push(h("dl", { class: "terms" }, ...board.legend.flatMap((line) => {
    const [term, ...rest] = line.split(/\s+/);
    return [h("dt", {}, term), h("dd", {}, rest.join(" "))];
  })));
  return parts;
}
