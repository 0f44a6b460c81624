// One run: its results, plan, versions and machine.

import { count, date, failure, get, h, loading, score, seed, setText, table } from "./dom.js";
import { badge, progress, timeLeft } from "./runs.js";
import { listen } from "./stream.js";

const REFRESH_SECONDS = 3;

export async function mount(element, { path }) {
  const id = path[0] ?? "";
  const title = h("h1", {}, "Run");
  const head = h("div", { class: "head" });
  const links = h("p", { class: "links" });
  const content = h("div", {}, loading());
  element.append(title, head, links, content);

  let timer = null;
  let stopped = false;
  async function refresh() {
    timer = null;
    try {
      const open = [...content.querySelectorAll("details[open]")].map((one) => one.dataset.part);
      const parts = draw(await get(`run/${encodeURIComponent(id)}`));
      for (const part of parts) if (open.includes(part.dataset?.part)) part.open = true;
      if (!stopped) content.replaceChildren(...parts);
    } catch (error) {
      if (!stopped) content.replaceChildren(failure(error));
    }
  }
  let first = true;
  const stop = listen("runs", (changed, all) => {
    const run = all.get(id);
    if (!run) {
      content.replaceChildren(failure("There is no such run any more."));
      return;
    }
    if (!(id in changed)) return;
    setText(title, run.name);
    head.replaceChildren(badge(run.state), progress(run), h("span", {}, timeLeft(run) && `${timeLeft(run)} left`));
    if (first) {
      links.replaceChildren(
        h("a", { class: "button", href: `#/curves?run=${id}` }, "Curves"),
        h("a", { class: "button", href: `#/game/${id}` }, "Game"));
      if (run.competition) links.append(h("a", { class: "button", href: `#/standings/${id}` }, "Standings"));
    }
    if (first) refresh();
    else timer ??= setTimeout(refresh, REFRESH_SECONDS * 1000);
    first = false;
  });
  return () => {
    stopped = true;
    stop();
    clearTimeout(timer);
  };
}

function draw(run) {
  const parts = [];
  if (run.reason) parts.push(h("p", { class: run.state === "failed" ? "failure" : "quiet" }, run.reason));
  parts.push(settingsTable(run.settings));
  parts.push(table("Trials", ["trial", "seed", "episodes", "voids", "failure"],
    run.trial_records.map((trial) => [trial.name, seed(trial.seed),
      `${count(trial.episodes)} / ${count(trial.planned_episodes)}`, count(trial.voids), trial.failure ?? ""])));
  if (run.trial_records_left_out) parts.push(h("p", { class: "quiet" }, `and ${count(run.trial_records_left_out)} more`));
  if (run.plan) parts.push(fold("plan", run.competition ? "Competition" : "Plan", h("pre", { tabindex: "0" }, run.plan)));
  parts.push(fold("versions", "Versions and machine", ...about(run)));
  if (run.answers.length) {
    parts.push(fold("answers", "What the agents answered last", table("What the agents answered last",
      ["trial", "after episode", "message", "answer"],
      run.answers.map((one) => [one.trial_id, count(one.episode), one.message, one.answer]))));
    if (run.answers_left_out) parts.at(-1).append(h("p", { class: "quiet" }, `and ${count(run.answers_left_out)} more`));
  }
  if (run.voids.length) {
    parts.push(fold("voids", `Voided attempts (${count(run.voids.length + run.voids_left_out)})`,
      table("Voided attempts", ["time", "trial", "episode", "why"],
        run.voids.map((one) => [date(one.time), one.trial_id, count(one.episode), one.why]))));
  }
  if (run.events.length) {
    parts.push(fold("events", `Events (${count(run.events.length + run.events_left_out)})`,
      table("Events", ["time", "trial", "kind", "what"],
        run.events.map((one) => [date(one.time), one.trial_id ?? "", one.kind, one.text]))));
  }
  return parts;
}

/** The mark of an interval of few trials, as in glue-results: it may well miss the mean. */
export const FEW = " (!)";

/** Return the table of settings, with the numbers of `glue-results show`. */
export function settingsTable(settings, marks = []) {
  return table("Results, by setting", ["setting", "finished", "episodes", "mean", "95 % interval", "IQM", "converged"],
    settings.map((one, i) => [
      marks[i] ? h("span", {}, marks[i], " ", one.setting) : one.setting,
      `${count(one.finished_trials)} / ${count(one.trials)}`, count(one.episodes), score(one.mean),
      one.low === null ? "-" : `${score(one.low)} to ${score(one.high)}${one.few_trials ? FEW : ""}`, score(one.interquartile_mean),
      one.converged === null ? "-" : count(one.converged)]));
}

function about(run) {
  const { machine = {}, packages = {}, program = "", python = "" } = run.about;
  const facts = [["program", run.programs.join(", then ") || program], ["Python", python], ["directory", run.run],
    ...Object.entries(machine)];
  return [
    h("dl", {}, ...facts.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, String(value))])),
    table("Packages", ["package", "version"], Object.entries(packages).map(([name, version]) => [name, String(version)])),
  ];
}

const fold = (part, title, ...children) => h("details", { "data-part": part }, h("summary", {}, title), ...children);
