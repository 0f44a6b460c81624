// Learning curves: over episodes or steps, with bands; single trials on hover; the table of the same numbers beside.

import { count, failure, get, h, score, setText, table } from "./dom.js";
import { settingsTable } from "./run.js";
import { listen } from "./stream.js";
import uPlot from "./uplot/uPlot.esm.js";

const REFRESH_SECONDS = 2;
const HEIGHT = 420;
const TABLE_ROWS = 12;
// Okabe and Ito's colors, which the color-blind can tell apart; each line has its own dash and mark, too.
const LIGHT = ["#0072b2", "#b34f00", "#00795a", "#a8497f", "#8a6100", "#2b7fae", "#333333"];
const DARK = ["#6cb8ec", "#ff9a4d", "#3fd0a4", "#f0a3cd", "#f0c04a", "#9adcff", "#eeeeee"];
const DASHES = [[], [10, 4], [2, 4], [10, 4, 2, 4], [16, 6], [5, 3]];
const MARKS = ["●", "▲", "■", "◆", "▼", "✚", "★"];

/** Return the values of `lines`, each with its own places, at all places together: what uPlot draws. */
function joined(lines) {
  return uPlot.join(lines.map(({ at, values }) => [at, ...values]));
}

export function mount(element, { query }) {
  const chosen = new Set(query.getAll("run"));
  const state = { over: query.get("over") === "steps" ? "steps" : "episodes", window: query.get("window") || "100",
    logX: query.get("x") === "log", logY: query.get("y") === "log", span: null };
  let plot = null;
  let data = null;
  let timer = null;
  let request = null;
  let hovered = -1;
  let ended = false;

  const picker = h("details", { class: "picker" }, h("summary", {}, "Runs"));
  const boxes = h("div", { class: "boxes" });
  picker.append(boxes);
  const toggle = (label, isOn, action) => {
    const button = h("button", { type: "button", "aria-pressed": String(isOn()) }, label);
    button.addEventListener("click", () => {
      action();
      for (const one of toggles) one.button.setAttribute("aria-pressed", String(one.isOn()));
    });
    toggles.push({ button, isOn });
    return button;
  };
  const toggles = [];
  const width = h("input", { type: "number", id: "window", min: "1", max: "1000000", value: state.window,
    onchange: () => { state.window = width.value || "100"; save(); refresh(); } });
  const over = (name) => () => { state.over = name; state.span = null; save(); refresh(); };
  const scale = (axis, isLog) => () => { state[axis] = isLog; save(); draw(); };
  const reset = h("button", { type: "button", disabled: true, onclick: () => { state.span = null; refresh(); } }, "Whole run");
  const box = h("div", { class: "plot", tabindex: "0", role: "img", "aria-label": "Learning curves",
    "aria-describedby": "curve-note", hidden: true, onkeydown: move });
  const note = h("p", { id: "curve-note", class: "quiet" });
  const readout = h("p", { class: "readout", role: "status", "aria-live": "polite" });
  const legend = h("ul", { class: "legend" });
  const tables = h("div");
  const problem = h("div");
  element.append(h("h1", {}, "Curves"), picker,
    h("div", { class: "controls" },
      h("fieldset", {}, h("legend", {}, "over"), toggle("episodes", () => state.over === "episodes", over("episodes")),
        toggle("steps", () => state.over === "steps", over("steps"))),
      h("fieldset", {}, h("legend", {}, "across"), toggle("linear", () => !state.logX, scale("logX", false)),
        toggle("log", () => state.logX, scale("logX", true))),
      h("fieldset", {}, h("legend", {}, "return"), toggle("linear", () => !state.logY, scale("logY", false)),
        toggle("log", () => state.logY, scale("logY", true))),
      h("label", { for: "window" }, "running mean of"), width, h("span", {}, "episodes"), reset,
      h("button", { type: "button", onclick: savePicture }, "PNG"),
      h("button", { type: "button", onclick: saveTable }, "CSV")),
    problem, h("div", { class: "card" }, box, legend, readout, note), tables);

  function save() {
    const search = new URLSearchParams([...chosen].map((id) => ["run", id]));
    if (state.over !== "episodes") search.set("over", state.over);
    if (state.window !== "100") search.set("window", state.window);
    if (state.logX) search.set("x", "log");
    if (state.logY) search.set("y", "log");
    history.replaceState(null, "", `#/curves?${search}`);
  }

  async function refresh() {
    clearTimeout(timer);
    timer = null;
    request?.abort();
    request = new AbortController();
    if (!chosen.size) {
      data = null;
      plot?.destroy();
      plot = null;
      legend.replaceChildren();
      tables.replaceChildren();
      box.hidden = true;
      setText(note, "Choose one or more runs above.");
      return;
    }
    const query = { run: [...chosen], window: state.window, over: state.over };
    if (state.span) [query.from, query.to] = state.span;
    try {
      const found = await get("curves", query, request.signal);
      if (ended) return;
      data = found;
      problem.replaceChildren();
      draw();
    } catch (error) {
      if (error.name !== "AbortError" && !ended) problem.replaceChildren(failure(error));
    }
  }

  function draw() {
    if (!data) return;
    plot?.destroy();
    plot = null;
    reset.disabled = !state.span;
    const styles = getComputedStyle(document.documentElement);
    const text = styles.getPropertyValue("--text").trim();
    const grid = styles.getPropertyValue("--line").trim();
    const colors = styles.colorScheme.startsWith("dark") ? DARK : LIGHT;
    const series = [{ label: state.over.slice(0, -1) }];
    const bands = [];
    const lines = [];
    data.curves.forEach((curve, i) => {
      const color = colors[i % colors.length];
      const first = series.length;
      series.push({ label: curve.label, stroke: color, width: 2.5, dash: DASHES[i % DASHES.length], spanGaps: true, points: { show: false } },
        { stroke: "transparent", spanGaps: true, points: { show: false } },
        { stroke: "transparent", spanGaps: true, points: { show: false } });
      bands.push({ series: [first + 2, first + 1], fill: `${color}33` });
      lines.push({ at: curve.at, values: [curve.mean, curve.low, curve.high] });
      curve.singles.forEach((values) => {
        series.push({ stroke: `${color}99`, width: 1, show: false, spanGaps: true, points: { show: false }, curve: i });
      });
      if (curve.singles.length) lines.push({ at: curve.single_at, values: curve.singles });
    });
    const values = data.curves.flatMap((curve) => curve.mean).filter((value) => value !== null);
    const positive = values.every((value) => value > 0);
    const axis = { stroke: text, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid }, font: "13px system-ui" };
    box.hidden = !lines.length;
    if (lines.length) {
      plot = new uPlot({
        width: Math.max(box.clientWidth, 280), height: HEIGHT, series, bands,
        scales: { x: { time: false, distr: state.logX ? 3 : 1 },
          // A return can be negative: then the scale is logarithmic on both sides of 0.
          y: { distr: state.logY ? (positive ? 3 : 4) : 1 } },
        axes: [{ ...axis, label: state.over.slice(0, -1), labelFont: "13px system-ui" },
          { ...axis, label: "episode return (reward)", labelFont: "13px system-ui", size: 64 }],
        legend: { show: false }, cursor: { drag: { x: true, y: false, setScale: false } },
        hooks: { setSelect: [select], setCursor: [hover] },
      }, joined(lines), box);
    }
    legend.replaceChildren(...data.curves.map((curve, i) => {
      const mark = h("span", { class: "mark", "aria-hidden": "true" }, MARKS[i % MARKS.length]);
      mark.style.color = colors[i % colors.length];
      return h("li", {}, h("button", { type: "button", class: "quiet", onfocus: () => highlight(i), onmouseenter: () => highlight(i),
        onblur: () => highlight(-1), onmouseleave: () => highlight(-1) }, mark, " ", curve.label, ` (${count(curve.trials)} trials)`));
    }));
    const what = `running mean of ${count(data.window)} episodes, with 95 % bootstrap bands`;
    setText(note, data.curves.length
      ? `${what}${state.span ? "; a part" : ""}. Drag to zoom; point at a curve, or at its name, for its single trials. The tables below hold the same numbers.`
      : "No trial has as many episodes as the running mean needs yet.");
    box.setAttribute("aria-label", `Learning curves of ${data.curves.map((curve) => curve.label).join("; ")}: ${what}`);
    fillTables();
  }

  function fillTables() {
    const focus = tables.contains(document.activeElement);
    if (focus) return;
    const marks = data.settings.map((setting) => {
      const i = data.curves.findIndex((curve) => curve.label === setting.setting);
      return i < 0 ? "" : MARKS[i % MARKS.length];
    });
    tables.replaceChildren(settingsTable(data.settings, marks), ...data.curves.map((curve) => {
      const every = Math.max(1, Math.floor((curve.at.length - 1) / TABLE_ROWS));
      const rows = curve.at.map((at, i) => i).filter((i) => i % every === 0 || i === curve.at.length - 1);
      return table(`${curve.label}: running mean`, [state.over.slice(0, -1), "mean return", "95 % band"],
        rows.map((i) => [count(curve.at[i]), score(curve.mean[i]),
          curve.low[i] === null ? "-" : `${score(curve.low[i])} to ${score(curve.high[i])}`]));
    }));
  }

  function select(u) {
    const { left, width: wide } = u.select;
    if (wide < 5) return;
    state.span = [Math.max(0, Math.floor(u.posToVal(left, "x"))), Math.ceil(u.posToVal(left + wide, "x"))];
    u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    refresh();
  }

  function nearest(u) {
    const { left, top, idx } = u.cursor;
    if (idx === null || idx === undefined || left < 0) return -1;
    let best = -1;
    let least = 30;
    data.curves.forEach((curve, i) => {
      const at = curve.at;
      const x = u.data[0][idx];
      let k = at.findIndex((value) => value >= x);
      if (k < 0) k = at.length - 1;
      const away = Math.abs(u.valToPos(curve.mean[k], "y") - top);
      if (away < least) [best, least] = [i, away];
    });
    return best;
  }

  function hover(u) {
    const { idx } = u.cursor;
    highlight(nearest(u));
    if (idx === null || idx === undefined) {
      setText(readout, "");
      return;
    }
    const x = u.data[0][idx];
    setText(readout, `${state.over.slice(0, -1)} ${count(x)}: ` + data.curves.map((curve) => {
      let k = curve.at.findIndex((value) => value >= x);
      if (k < 0) k = curve.at.length - 1;
      return `${curve.label} ${score(curve.mean[k])}` + (curve.low[k] === null ? "" : ` (${score(curve.low[k])} to ${score(curve.high[k])})`);
    }).join("; "));
  }

  function highlight(i) {
    if (i === hovered || !plot) return;
    hovered = i;
    plot.batch(() => plot.series.forEach((series, s) => {
      if (series.curve !== undefined && series.show !== (series.curve === i)) plot.setSeries(s, { show: series.curve === i });
    }));
  }

  function move(event) {
    if (!plot || !data) return;
    const last = plot.data[0].length - 1;
    const now = plot.cursor.idx ?? -1;
    const next = { ArrowLeft: now - 1, ArrowRight: now + 1, Home: 0, End: last }[event.key];
    if (next === undefined) return;
    event.preventDefault();
    const x = plot.data[0][Math.min(last, Math.max(0, next))];
    plot.setCursor({ left: plot.valToPos(x, "x"), top: plot.valToPos(data.curves[0].mean[0], "y") });
  }

  function download(name, href) {
    const link = h("a", { href, download: name });
    link.click();
  }

  function savePicture() {
    if (!plot) return;
    const from = plot.ctx.canvas;
    const canvas = h("canvas", { width: from.width, height: from.height + 30 * data.curves.length });
    const context = canvas.getContext("2d");
    const styles = getComputedStyle(document.documentElement);
    context.fillStyle = styles.getPropertyValue("--card").trim();
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.drawImage(from, 0, 0);
    const colors = styles.colorScheme.startsWith("dark") ? DARK : LIGHT;
    context.font = "18px system-ui";
    data.curves.forEach((curve, i) => {
      context.fillStyle = colors[i % colors.length];
      context.fillText(`${MARKS[i % MARKS.length]} ${curve.label}`, 20, from.height + 22 + 30 * i);
    });
    download("curves.png", canvas.toDataURL("image/png"));
  }

  function saveTable() {
    if (!data) return;
    // A spreadsheet takes a cell that begins so for a formula.
    const cell = (text) => `"${(/^[=+\-@]/.test(text) ? `'${text}` : text).replaceAll('"', '""')}"`;
    const rows = data.curves.flatMap((curve) => curve.at.map((at, i) =>
      [cell(curve.label), at, curve.mean[i] ?? "", curve.low[i] ?? "", curve.high[i] ?? ""].join(",")));
    const text = [`setting,${state.over.slice(0, -1)},mean,low,high`, ...rows].join("\n");
    const url = URL.createObjectURL(new Blob([`${text}\n`], { type: "text/csv" }));
    download("curves.csv", url);
    setTimeout(() => URL.revokeObjectURL(url), 1000);
  }

  const stop = listen("runs", (changed, all) => {
    boxes.replaceChildren(...[...all.values()].filter((run) => run.state !== "damaged").map((run) => {
      const box = h("input", { type: "checkbox", onchange: (event) => {
        if (event.target.checked) chosen.add(run.id);
        else chosen.delete(run.id);
        save();
        refresh();
      } });
      box.checked = chosen.has(run.id);
      return h("label", {}, box, " ", run.name);
    }));
    setText(picker.firstChild, `Runs: ${chosen.size ? [...chosen].map((id) => all.get(id)?.name ?? id).join(", ") : "none chosen"}`);
    if (!data && !timer) timer = setTimeout(refresh, 0);
    else if ([...chosen].some((id) => id in changed)) timer ??= setTimeout(refresh, REFRESH_SECONDS * 1000);
  });
  picker.open = !chosen.size;
  const resized = new ResizeObserver(() => plot?.setSize({ width: Math.max(box.clientWidth, 280), height: HEIGHT }));
  resized.observe(box);
  window.addEventListener("themechange", draw);
  return () => {
    ended = true;
    stop();
    clearTimeout(timer);
    request?.abort();
    resized.disconnect();
    window.removeEventListener("themechange", draw);
    plot?.destroy();
  };
}
