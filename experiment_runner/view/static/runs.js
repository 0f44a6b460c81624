// The list of runs: state, progress, time left; filters; and which to compare.

import { count, date, duration, h, setText } from "./dom.js";
import { listen } from "./stream.js";

export const STATES = ["running", "finished", "interrupted", "failed", "damaged"];
const MARKS = { running: "▶", finished: "✓", interrupted: "❚❚", failed: "✗", damaged: "⚠" };
const COLUMNS = ["Compare", "Run", "State", "Progress", "Time left", "Agents", "Environments", "Seeds", "Started"];

/** Return a label of a run's state, which does not tell it by color alone. */
export function badge(state) {
  return h("span", { class: `state ${state}` }, h("span", { "aria-hidden": "true" }, MARKS[state] ?? "", " "), state);
}

/** Return a bar of how many episodes of a run, or trials of a competition, are done, with the numbers. */
export function progress(run) {
  const done = run.done ?? 0;
  const planned = run.planned ?? 0;
  const unit = run.competition ? "trials" : "episodes";
  const percent = planned ? Math.floor((100 * done) / planned) : 0;
  return h("div", { class: "progress" },
    h("progress", { max: planned || 1, value: done, "aria-label": `${percent} % of the ${unit}` }),
    h("span", {}, `${count(done)} / ${count(planned)}${run.competition ? " trials" : ""}`));
}

/** Return what is known of the time that a run still takes. */
export function timeLeft(run) {
  if (run.state !== "running") return "";
  return run.seconds_left === null ? "…" : duration(run.seconds_left);
}

/** Return some of a list: seeds have up to 19 digits. */
function few(values) {
  return values.length <= 3 ? values.join(", ") : `${values[0]}, and ${count(values.length - 1)} more`;
}

export function mount(element, { query }) {
  const chosen = new Set();
  const rows = new Map(); // id -> { row, run }
  const search = h("input", { type: "search", id: "search", placeholder: "agent, environment, name …",
    value: query.get("search") ?? "", oninput: filter });
  const state = h("select", { id: "state", onchange: filter }, h("option", { value: "" }, "all states"),
    ...STATES.map((name) => h("option", { value: name }, name)));
  state.value = query.get("state") ?? "";
  const compare = h("a", { class: "button", href: "#/curves", "aria-disabled": "true" }, "Compare");
  const summary = h("p", { class: "quiet", role: "status" });
  const body = h("tbody");
  const empty = h("div", { class: "empty", hidden: true }, h("p", {}, "There is no run here yet. This starts one:"),
    h("pre", {}, "glue-experiment --env mario --agent hierarchical --episodes 500 --view"));
  const box = h("div", { class: "scroll cards", tabindex: "0", role: "region", "aria-label": "Runs" },
    h("table", { class: "runs" },
      h("thead", {}, h("tr", {}, ...COLUMNS.map((name) => h("th", { scope: "col" }, name)))), body));
  element.append(
    h("h1", {}, "Runs"),
    h("form", { class: "filters", role: "search", onsubmit: (event) => event.preventDefault() },
      h("label", { for: "search" }, "Search"), search, h("label", { for: "state" }, "State"), state, compare, summary),
    empty, box);

  function filter() {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    let visible = 0;
    for (const { row, run } of rows.values()) {
      const text = [run.name, run.state, ...(run.agents ?? []), ...(run.environments ?? [])].join(" ").toLowerCase();
      const shown = (!state.value || run.state === state.value) && words.every((word) => text.includes(word));
      row.hidden = !shown;
      visible += shown;
    }
    const all = rows.size;
    setText(summary, visible === all ? `${count(all)} ${all === 1 ? "run" : "runs"}` : `${count(visible)} of ${count(all)} runs`);
    empty.hidden = all > 0;
    box.hidden = all === 0;
  }

  function choose(id, isChosen) {
    if (isChosen) chosen.add(id);
    else chosen.delete(id);
    compare.setAttribute("aria-disabled", String(chosen.size === 0));
    compare.href = `#/curves?${[...chosen].map((one) => `run=${one}`).join("&")}`;
    setText(compare, chosen.size > 1 ? `Compare ${chosen.size} runs` : "Compare");
  }

  function draw(run) {
    const link = run.state === "damaged" ? h("span", {}, run.name) : h("a", { href: `#/run/${run.id}` }, run.name);
    const box = h("input", { type: "checkbox", "aria-label": `compare ${run.name}`, disabled: run.state === "damaged",
      onchange: (event) => choose(run.id, event.target.checked) });
    box.checked = chosen.has(run.id);
    const reason = ["failed", "damaged"].includes(run.state) ? h("div", { class: "reason" }, run.reason) : null;
    const cells = [box, link, h("div", {}, badge(run.state), reason), progress(run), timeLeft(run),
      (run.agents ?? []).join(", "), (run.environments ?? []).join(", "), few(run.seeds ?? []),
      date(run.started ?? null)];
    return h("tr", { "data-run": run.id }, ...cells.map((cell, i) =>
      h(i === 1 ? "th" : "td", { "data-label": COLUMNS[i], scope: i === 1 ? "row" : null }, cell)));
  }

  const stop = listen("runs", (changed) => {
    for (const [id, run] of Object.entries(changed)) {
      const old = rows.get(id)?.row;
      if (run === null) {
        old?.remove();
        rows.delete(id);
        choose(id, false);
        continue;
      }
      const focused = old?.contains(document.activeElement) ? document.activeElement.tagName : null;
      const row = draw(run);
      if (old) old.replaceWith(row);
      else body.append(row);
      if (focused) row.querySelector(focused)?.focus();
      rows.set(id, { row, run });
    }
    const newest = (one) => one.run.started ?? 0;
    const order = [...rows.values()].sort((a, b) => newest(b) - newest(a) || (a.run.name < b.run.name ? -1 : 1));
    // Only a row that is out of place is moved: the others keep the focus and the selection.
    order.forEach(({ row }, i) => {
      if (body.children[i] !== row) body.insertBefore(row, body.children[i] ?? null);
    });
    filter();
  });
  filter();
  return stop;
}
