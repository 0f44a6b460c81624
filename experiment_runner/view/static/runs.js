// The list of runs: state, progress, returns, options, notes and tags; filters, order and groups; runs to compare.

import { count, date, duration, failure, h, loading, put, score, setText } from "./dom.js";
import { listen } from "./stream.js";

export const STATES = ["running", "finished", "interrupted", "failed", "damaged"];
const MARKS = { running: "▶", finished: "✓", interrupted: "❚❚", failed: "✗", damaged: "⚠" };
const COLUMNS = ["Compare", "Run", "State", "Progress", "Time left", "Agents", "Environments", "Return", "Started", "Notes"];
const ORDERS = { Run: (run) => run.name, State: (run) => run.state, Agents: (run) => (run.agents ?? []).join(), Return: (run) => best(run),
  Environments: (run) => (run.environments ?? []).join(), Progress: (run) => run.done ?? 0, Started: (run) => run.started ?? 0 };
const DOWN = ["Started", "Return", "Progress"]; // sorted in descending order first
const GROUPS = { agents: (run) => run.agents ?? [], environments: (run) => run.environments ?? [], state: (run) => [run.state],
  tags: (run) => run.tags ?? [] };
const words = new Intl.Collator("en");

/** Compare two texts, as numbers if both are. */
function compared(a, b) {
  const [first, second] = [Number(a), Number(b)];
  return (a !== "" && b !== "" && (first - second || 0)) || words.compare(a, b);
}


/** Return a label of a run's state, shown not only by color. */
export function badge(state) {
  return h("span", { class: `state ${state}` }, h("span", { "aria-hidden": "true" }, MARKS[state] ?? "", " "), state);
}

/** Return a progress bar of a run's episodes, or a competition's trials, with the numbers. */
export function progress(run) {
  const done = run.done ?? 0;
  const planned = run.planned ?? 0;
  const unit = run.competition ? "trials" : "episodes";
  const percent = planned ? Math.floor((100 * done) / planned) : 0;
  return h("div", { class: "progress" },
    h("progress", { max: planned || 1, value: done, "aria-label": `${percent} % of the ${unit}` }),
    h("span", {}, `${count(done)} / ${count(planned)}${run.competition ? " trials" : ""}`));
}

/** Return the estimated time left of a run, if known. */
export function timeLeft(run) {
  if (run.state !== "running") return "";
  return run.seconds_left === null ? "…" : duration(run.seconds_left);
}

/** Return the best return of a run's settings. */
const best = (run) => ((run.returns ?? []).length ? Math.max(...run.returns) : -Infinity);

/** Return the returns of a run's settings: the mean of the last 100 episodes of each trial. */
function returns({ returns: found = [] }) {
  if (found.length < 2) return found.map(score).join();
  return `${score(Math.min(...found))} to ${score(Math.max(...found))}`;
}

/** Return a run's value for a group; names of options are prefixed with "option ". */
function grouped(run, group) {
  const values = group in GROUPS ? GROUPS[group](run) : run.options?.[group.replace(/^option /, "")] ?? [];
  return [...values].sort(compared).join(", ");
}

/** Return the cell of a run's notes and tags, with a button to edit them. */
function notes(run) {
  const cell = h("div", { class: "notes" });
  const show = () => cell.replaceChildren(...(run.tags ?? []).map((tag) => h("span", { class: "tag" }, tag)), " ", run.note ?? "", " ",
    h("button", { type: "button", class: "quiet", "aria-label": `Edit the notes of ${run.name}`, onclick: edit }, "✎"));
  const edit = () => {
    const tags = h("input", { type: "text", value: (run.tags ?? []).join(", "), placeholder: "tags, with commas", "aria-label": "Tags" });
    const note = h("input", { type: "text", value: run.note ?? "", placeholder: "note", "aria-label": "Note" });
    const save = async (event) => {
      event.preventDefault();
      try {
        Object.assign(run, await put(`notes/${run.id}`, { note: note.value, tags: tags.value.split(",") }));
        show();
      } catch (error) {
        cell.append(failure(error));
      }
    };
    cell.replaceChildren(h("form", { class: "editing", onsubmit: save }, tags, note, h("button", {}, "Save"),
      h("button", { type: "button", class: "quiet", onclick: show }, "Cancel")));
    tags.focus();
  };
  show();
  return cell;
}

export function mount(element, { query }) {
  const chosen = new Set();
  const rows = new Map(); // id -> { row, run }
  const search = h("input", { type: "search", id: "search", placeholder: "agent, environment, name …",
    value: query.get("search") ?? "", oninput: filter });
  const state = h("select", { id: "state", onchange: filter }, h("option", { value: "" }, "all states"),
    ...STATES.map((name) => h("option", { value: name }, name)));
  state.value = query.get("state") ?? "";
  const group = h("select", { id: "group", onchange: arrange });
  let order = "Started";
  let reversed = false;
  const heads = COLUMNS.map((name) => h("th", { scope: "col" }, name in ORDERS
    ? h("button", { type: "button", class: "quiet", onclick: () => sortBy(name) }, name) : name));
  const compare = h("a", { class: "button", href: "#/curves", "aria-disabled": "true" }, "Compare");
  const summary = h("p", { class: "quiet", role: "status" });
  const body = h("tbody");
  const waiting = loading();
  let loaded = false;
  const empty = h("div", { class: "empty", hidden: true }, h("p", {}, "There is no run here yet. This starts one:"),
    h("pre", {}, "glue-experiment --env mario --agent hierarchical --episodes 500 --view"));
  const box = h("div", { class: "scroll cards", tabindex: "0", role: "region", "aria-label": "Runs" },
    h("table", { class: "runs" },
      h("thead", {}, h("tr", {}, ...heads)), body));
  element.append(
    h("h1", {}, "Runs"),
    h("form", { class: "filters", role: "search", onsubmit: (event) => event.preventDefault() },
      h("label", { for: "search" }, "Search"), search, h("label", { for: "state" }, "State"), state,
      h("label", { for: "group" }, "Group by"), group, compare, summary),
    waiting, empty, box);

  function filter() {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    let visible = 0;
    for (const { row, run } of rows.values()) {
      const options = Object.entries(run.options ?? {}).flatMap(([name, values]) => values.map((value) => `${name}=${value}`));
      const text = [run.name, run.state, ...(run.agents ?? []), ...(run.environments ?? []), ...options, ...(run.tags ?? []),
        run.note ?? ""].join(" ").toLowerCase();
      const shown = (!state.value || run.state === state.value) && words.every((word) => text.includes(word));
      row.hidden = !shown;
      visible += shown;
    }
    let heading = null; // of a group, which is hidden with its last run
    for (const row of body.children) {
      if (row.className === "group") [heading, row.hidden] = [row, true];
      else if (heading && !row.hidden) heading.hidden = false;
    }
    const all = rows.size;
    setText(summary, visible === all ? `${count(all)} ${all === 1 ? "run" : "runs"}` : `${count(visible)} of ${count(all)} runs`);
    waiting.hidden = loaded;
    summary.hidden = !loaded;
    empty.hidden = all > 0 || !loaded;
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
      (run.agents ?? []).join(", "), (run.environments ?? []).join(", "), returns(run),
      date(run.started ?? null), notes(run)];
    return h("tr", { "data-run": run.id }, ...cells.map((cell, i) =>
      h(i === 1 ? "th" : "td", { "data-label": COLUMNS[i], scope: i === 1 ? "row" : null }, cell)));
  }

  function sortBy(name) {
    reversed = order === name && !reversed;
    order = name;
    arrange();
  }

  /** Offer every option of a run as a group. */
  function offer() {
    const options = [...new Set([...rows.values()].flatMap(({ run }) => Object.keys(run.options ?? {})))].sort(compared);
    const names = ["", ...Object.keys(GROUPS), ...options.map((name) => `option ${name}`)];
    if (names.join() === [...group.options].map((one) => one.value).join()) return;
    const chosenGroup = group.value;
    group.replaceChildren(...names.map((name) => h("option", { value: name }, name || "nothing")));
    group.value = names.includes(chosenGroup) ? chosenGroup : "";
  }

  /** Sort the rows, under a heading for each group. */
  function arrange() {
    offer();
    heads.forEach((head, i) => {
      const down = DOWN.includes(order) !== reversed;
      if (COLUMNS[i] === order) head.setAttribute("aria-sort", down ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    });
    const sign = DOWN.includes(order) !== reversed ? -1 : 1;
    const keyed = [...rows.values()].map((one) => ({ ...one, key: group.value ? grouped(one.run, group.value) : "" }));
    keyed.sort((a, b) => compared(a.key, b.key) || sign * compared(`${ORDERS[order](a.run)}`, `${ORDERS[order](b.run)}`) ||
      compared(a.run.name, b.run.name));
    const wanted = [];
    keyed.forEach(({ row, key }, i) => {
      if (group.value && (!i || key !== keyed[i - 1].key)) {
        wanted.push(h("tr", { class: "group" }, h("th", { colspan: COLUMNS.length, scope: "rowgroup" },
          `${group.value.replace(/^option /, "")}: ${key || "none"}`)));
      }
      wanted.push(row);
    });
    body.querySelectorAll(".group").forEach((one) => one.remove());
    // Only misplaced rows are moved: the others keep the focus and the selection.
    wanted.forEach((row, i) => {
      if (body.children[i] !== row) body.insertBefore(row, body.children[i] ?? null);
    });
    filter();
  }

  const stop = listen("runs", (changed) => {
    loaded = true;
    for (const [id, run] of Object.entries(changed)) {
      const old = rows.get(id)?.row;
      if (run === null) {
        old?.remove();
        rows.delete(id);
        choose(id, false);
        continue;
      }
      if (old?.querySelector(".editing")) {
        rows.set(id, { row: old, run }); // keeps the text being typed
        continue;
      }
      const focused = old?.contains(document.activeElement) ? document.activeElement.tagName : null;
      const row = draw(run);
      if (old) old.replaceWith(row);
      else body.append(row);
      if (focused) row.querySelector(focused)?.focus();
      rows.set(id, { row, run });
    }
    arrange();
  });
  filter();
  return stop;
}
