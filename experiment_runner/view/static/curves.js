// Learning curves drawn by the server: over episodes or steps, with bands, single trials on hover, and tables.

import { count, drawing, failure, get, h, score, setText, table } from "./dom.js";
import { FEW, settingsTable } from "./run.js";
import { listen } from "./stream.js";

const REFRESH_SECONDS = 2;
const HEIGHT = 420;
const WIDTHS = { least: 280, most: 2000, step: 20 }; // of a drawing, in pixels
const TABLE_ROWS = 12;
const NEAR = 30; // pixels between the pointer and a curve that it selects
const FINE = 2; // pixels of a saved picture per pixel here
const SVG = "http://www.w3.org/2000/svg";
const MARKS = ["●", "▲", "■", "◆", "▼", "✚", "★"];
const PAINT = ["fill", "fill-opacity", "stroke", "stroke-width", "font-family", "font-size", "display"];

// The transform of each kind of scale, and its inverse, as in experiment_runner/report/svg.py.
const BENT = { linear: (v) => v, log: (v) => Math.log10(Math.max(v, 1e-300)), symlog: (v) => Math.sign(v) * Math.log10(1 + Math.abs(v)) };
const STRAIGHT = { linear: (v) => v, log: (v) => 10 ** v, symlog: (v) => Math.sign(v) * (10 ** Math.abs(v) - 1) };

/** Return the position of a value along a scale, from 0 to 1. */
function share({ kind, low, high }, value) {
  const [first, last] = [BENT[kind](low), BENT[kind](high)];
  return (BENT[kind](value) - first) / (last - first || 1);
}

/** Return the value at a position along a scale, from 0 to 1. */
function valueAt({ kind, low, high }, part) {
  const [first, last] = [BENT[kind](low), BENT[kind](high)];
  return STRAIGHT[kind](first + part * (last - first));
}

export function mount(element, { query }) {
  const chosen = new Set(query.getAll("run"));
  const state = { over: query.get("over") === "steps" ? "steps" : "episodes", window: query.get("window") || "", measure: query.get("measure") || "return",
    logX: query.get("x") === "log", logY: query.get("y") === "log", span: null };
  let panels = []; // a drawing for each environment: its element `plot`, and what the server says of it
  let places = []; // of all curves, along the axis
  let cursor = -1; // index of the place being read
  let from = null; // the start of a drag: its panel and place
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
  const width = h("input", { type: "number", id: "window", min: "1", max: "1000000000", placeholder: "100", value: state.window,
    onchange: () => { state.window = width.value; save(); refresh(); } });
  const measures = h("select", { id: "measure", onchange: () => { state.measure = measures.value; save(); refresh(); } });
  const unit = h("span", {}, state.over);
  const over = (name) => () => {
    [state.over, state.span, state.window, width.value] = [name, null, "", ""];
    unit.textContent = name;
    save();
    refresh();
  };
  const scale = (axis, isLog) => () => { state[axis] = isLog; save(); refresh(); };
  const reset = h("button", { type: "button", disabled: true, onclick: () => { state.span = null; refresh(); } }, "Whole run");
  const box = h("div", { class: "plot", tabindex: "0", role: "img", "aria-label": "Learning curves",
    "aria-describedby": "curve-note", hidden: true, onkeydown: move, onpointerdown: press, onpointermove: point,
    onpointerup: release, onpointerleave: leave });
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
      h("label", { for: "measure" }, "measure"), measures,
      h("label", { for: "window" }, "running mean of"), width, unit, reset,
      h("button", { type: "button", onclick: savePicture }, "PNG"),
      h("button", { type: "button", onclick: saveTable }, "CSV")),
    problem, h("div", { class: "card" }, box, legend, readout, note), tables);

  function save() {
    const search = new URLSearchParams([...chosen].map((id) => ["run", id]));
    if (state.over !== "episodes") search.set("over", state.over);
    if (state.measure !== "return") search.set("measure", state.measure);
    if (state.window) search.set("window", state.window);
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
      panels = [];
      box.replaceChildren();
      legend.replaceChildren();
      tables.replaceChildren();
      box.hidden = true;
      setText(note, "Choose one or more runs above.");
      return;
    }
    const query = { run: [...chosen], window: state.window, over: state.over, measure: state.measure, width: room(),
      log: [state.logX && "x", state.logY && "y"].filter(Boolean) };
    if (state.span) [query.from, query.to] = state.span;
    if (!data) setText(note, "Loading …");
    try {
      const found = await get("curves", query, request.signal);
      if (ended) return;
      data = found;
      problem.replaceChildren();
      draw();
    } catch (error) {
      if (error.name === "AbortError" || ended) return;
      if (!data) setText(note, "");
      problem.replaceChildren(failure(error));
    }
  }

  /** Return the width available to a drawing. */
  function room() {
    const { least, most, step } = WIDTHS;
    return Math.min(Math.max(Math.floor((box.parentElement.clientWidth - 32) / step) * step, least), most);
  }

  function draw() {
    if (!data) return;
    const place = readout.textContent ? places[cursor] : Infinity;
    const focused = [...legend.children].findIndex((item) => item.contains(document.activeElement));
    reset.disabled = !state.span;
    if (!measures.options.length) measures.replaceChildren(...data.measures.map((name) => h("option", { value: name }, name)));
    measures.value = data.measure;
    places = [...new Set(data.curves.flatMap((curve) => curve.at))].sort((a, b) => a - b);
    [cursor, hovered, from] = [-1, -1, null];
    panels = data.drawings.map((one) => ({ ...one, plot: drawing(one.svg) }));
    box.hidden = !panels.length;
    box.replaceChildren(...panels.map(({ environment, plot }) =>
      h("figure", {}, environment ? h("figcaption", {}, environment) : null, plot)));
    const next = places.findIndex((other) => other >= place);
    if (panels.length && next >= 0) read(next); // readers keep their place while the runs grow
    else setText(readout, "");
    legend.replaceChildren(...data.curves.map((curve, i) =>
      h("li", {}, h("button", { type: "button", class: "quiet", onfocus: () => highlight(i), onmouseenter: () => highlight(i),
        onblur: () => highlight(-1), onmouseleave: () => highlight(-1) }, drawing(curve.sample), " ",
      h("span", { "aria-hidden": "true" }, MARKS[i % MARKS.length]), " ", curve.label, ` (${count(curve.trials)} trials${few(curve)})`))));
    legend.children[focused]?.querySelector("button").focus();
    const what = `running mean of ${count(data.window)} ${state.over}, with 95 % bootstrap bands`;
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
      return table(`${curve.label}: running mean`, [state.over.slice(0, -1), `mean ${data.measure}`, "95 % band"],
        rows.map((i) => [count(curve.at[i]), score(curve.mean[i]),
          curve.low[i] === null ? "-" : `${score(curve.low[i])} to ${score(curve.high[i])}`]));
    }));
  }

  /** Return the mark of a curve whose interval is one of few trials. */
  const few = (curve) => (data.settings.find((one) => one.setting === curve.label)?.few_trials ? FEW : "");

  /** Return the panel under the pointer. */
  const panelAt = ({ target }) => panels.find(({ plot }) => plot.contains(target));

  /** Return the pointer's position in a panel, in the drawing's own pixels. */
  function spot({ clientX, clientY }, { plot }) {
    const { left, top, width, height } = plot.getBoundingClientRect();
    const { viewBox: { baseVal } } = plot;
    return [((clientX - left) * baseVal.width) / width, ((clientY - top) * baseVal.height) / height];
  }

  /** Return the value on the horizontal axis of a panel at an x coordinate in pixels. */
  function across(panel, x) {
    const [left, , width] = panel.box;
    return valueAt(panel.x, Math.min(Math.max((x - left) / width, 0), 1));
  }

  /** Draw a path over the curves of a panel, replacing the previous path of its class. */
  function overlay({ plot }, name, path) {
    plot.querySelector(`.${name}`)?.remove();
    if (!path) return;
    const element = document.createElementNS(SVG, "path");
    element.setAttribute("class", name);
    element.setAttribute("d", path);
    plot.append(element);
  }

  function press(event) {
    const panel = panelAt(event);
    if (!panel || event.button) return;
    from = { panel, x: spot(event, panel)[0] };
    box.setPointerCapture(event.pointerId);
  }

  function release(event) {
    if (from === null) return;
    const { panel } = from;
    const [x] = spot(event, panel);
    const [first, last] = [Math.min(x, from.x), Math.max(x, from.x)];
    from = null;
    overlay(panel, "selection", "");
    if (last - first < 5) return;
    state.span = [Math.max(0, Math.floor(across(panel, first))), Math.ceil(across(panel, last))];
    refresh();
  }

  function point(event) {
    const panel = from?.panel ?? panelAt(event);
    if (!panel) return;
    const [x, y] = spot(event, panel);
    if (from !== null) {
      const [, top, , height] = panel.box;
      overlay(panel, "selection", `M${from.x} ${top}H${x}V${top + height}H${from.x}Z`);
      return;
    }
    const value = across(panel, x);
    let next = places.findIndex((place) => place >= value);
    if (next < 0) next = places.length - 1;
    if (next > 0 && value - places[next - 1] < places[next] - value) next -= 1;
    read(next);
    highlight(nearest(panel, y));
  }

  function leave() {
    for (const panel of panels) overlay(panel, "cursor", "");
    setText(readout, "");
    highlight(-1);
  }

  /** Return the index of a curve's point at a place, or of the next point. */
  function indexOf(curve, place) {
    const i = curve.at.findIndex((value) => value >= place);
    return i < 0 ? curve.at.length - 1 : i;
  }

  /** Return the index of the curve of a panel nearest to a height at the place being read, or -1. */
  function nearest(panel, y) {
    const [, top, , height] = panel.box;
    const away = panel.curves.map((i) => {
      const curve = data.curves[i];
      const value = curve.mean[indexOf(curve, places[cursor])];
      return value === null ? Infinity : Math.abs(top + height * (1 - share(panel.y, value)) - y);
    });
    const least = Math.min(...away);
    return least < NEAR ? panel.curves[away.indexOf(least)] : -1;
  }

  /** Show the numbers at a place. */
  function read(i) {
    cursor = i;
    const place = places[i];
    for (const panel of panels) {
      const [left, top, width, height] = panel.box;
      const at = share(panel.x, place);
      overlay(panel, "cursor", at < 0 || at > 1 ? "" : `M${left + width * at} ${top}V${top + height}`);
    }
    setText(readout, `${state.over.slice(0, -1)} ${count(place)}: ` + data.curves.map((curve) => {
      const k = indexOf(curve, place);
      return `${curve.label} ${score(curve.mean[k])}` + (curve.low[k] === null ? "" : ` (${score(curve.low[k])} to ${score(curve.high[k])})`);
    }).join("; "));
  }

  function highlight(i) {
    if (i === hovered) return;
    hovered = i;
    for (const { plot, curves } of panels) {
      for (const trials of plot.querySelectorAll(".trials")) trials.classList.toggle("lit", curves[Number(trials.dataset.curve)] === i);
    }
  }

  function move(event) {
    if (!panels.length) return;
    const last = places.length - 1;
    const next = { ArrowLeft: cursor - 1, ArrowRight: cursor + 1, Home: 0, End: last }[event.key];
    if (next === undefined) return;
    event.preventDefault();
    read(Math.min(last, Math.max(0, next)));
  }

  function download(name, href) {
    const link = h("a", { href, download: name });
    link.click();
  }

  /** Return a panel as an image, with the colors that the style sheet gives it. */
  async function imageOf({ plot }) {
    const copy = plot.cloneNode(true);
    const painted = [...plot.querySelectorAll("*")];
    [...copy.querySelectorAll("*")].forEach((element, i) => {
      const style = getComputedStyle(painted[i]);
      for (const name of PAINT) element.setAttribute(name, style.getPropertyValue(name));
    });
    const url = URL.createObjectURL(new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" }));
    const image = new Image();
    image.src = url;
    await image.decode();
    URL.revokeObjectURL(url);
    return image;
  }

  /** Save the panels, one below the other, and the legend. */
  async function savePicture() {
    if (!panels.length) return;
    const images = await Promise.all(panels.map(imageOf));
    const { width, height: tall } = panels[0].plot.viewBox.baseVal;
    const line = 24;
    const height = (tall + line) * panels.length;
    const canvas = h("canvas", { width: FINE * width, height: FINE * (height + line * data.curves.length) });
    const context = canvas.getContext("2d");
    const styles = getComputedStyle(document.documentElement);
    context.fillStyle = styles.getPropertyValue("--card").trim();
    context.fillRect(0, 0, canvas.width, canvas.height);
    context.scale(FINE, FINE);
    context.font = "14px system-ui";
    context.fillStyle = styles.getPropertyValue("--text").trim();
    images.forEach((image, i) => {
      context.fillText(panels[i].environment, 20, (tall + line) * i + 17);
      context.drawImage(image, 0, (tall + line) * i + line, width, tall);
    });
    context.lineWidth = 2.5;
    [...legend.querySelectorAll("polyline")].forEach((sample, i) => {
      const y = height + line * (i + 0.5);
      context.strokeStyle = getComputedStyle(sample).stroke;
      context.setLineDash((sample.getAttribute("stroke-dasharray") ?? "").split(" ").filter(Boolean).map(Number));
      context.beginPath();
      context.moveTo(20, y);
      context.lineTo(60, y);
      context.stroke();
      context.fillStyle = styles.getPropertyValue("--text").trim();
      context.fillText(data.curves[i].label, 70, y + 5);
    });
    download("curves.png", canvas.toDataURL("image/png"));
  }

  function saveTable() {
    if (!data) return;
    // A spreadsheet treats a cell that begins like this as a formula.
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
  let drawn = 0;
  const resized = new ResizeObserver(() => {
    if (drawn && drawn !== room()) refresh();
    drawn = room();
  });
  resized.observe(element);
  return () => {
    ended = true;
    stop();
    clearTimeout(timer);
    request?.abort();
    resized.disconnect();
  };
}
