// Shows moments: the observation as a drawing, the action, reward and return next to it, and all numbers below it.

import { get, h, setText, table } from "../dom.js";
import { inWords, textOf } from "./values.js";

const MOST_ROWS = 600;
const LINE = 22; // chars per row of the table, as in a row of Mario's tiles
const MOST_PIXELS = 4096; // of a drawing, in each direction
const MOST_MARKS = 1000;
const plain = new Intl.NumberFormat("en", { maximumFractionDigits: 4 });

/** Return the drawings that installed environments offer for a task spec, and the reasons why others cannot be used. */
async function openDrawings(spec) {
  const drawings = [];
  const problems = [];
  for (const { name, problem } of await get("drawings")) {
    const base = new URL(`drawings/${encodeURIComponent(name)}/`, document.baseURI);
    const file = async (path) => {
      const response = await fetch(new URL(path, base));
      if (!response.ok) throw new Error((await response.json()).error);
      return response;
    };
    try {
      if (problem) throw new Error(problem);
      const drawing = await (await import(new URL("drawing.js", base))).open(spec, file);
      if (drawing) drawings.push(drawing);
    } catch (error) {
      problems.push(`The drawing ${name} cannot be used: ${error.message}`);
    }
  }
  return { drawings, problems };
}

/** A view of moments, held by `element`. `spec` is the task spec, as the server describes it. */
export class Screen {
  constructor(spec, { drawings, problems }) {
    this._spec = spec;
    this._drawings = drawings;
    this._problems = problems;
    this._moment = null;
    this._names = null;
    this._messages = "";
    this._canvas = h("canvas", { role: "img", hidden: true });
    this._note = h("p", { class: "quiet" });
    this._facts = {};
    const facts = ["episode", "step", "action", "reward", "return", "state"].flatMap((name) => {
      this._facts[name] = h("dd", { "data-fact": name });
      return [h("dt", {}, name), this._facts[name]];
    });
    this._numbers = h("details", { class: "numbers", ontoggle: () => this._count() }, h("summary", {}, "Observation in numbers"));
    this._answers = h("dl");
    this._asked = h("div", { class: "answers", hidden: true }, h("h2", {}, "The agent's answers"), this._answers);
    this.beside = h("div", { class: "beside" }, h("dl", {}, ...facts), this._asked);
    this.below = h("div", { class: "below" });
    this.element = h("div", { class: "screen" }, h("figure", {}, this._canvas, this._note), this.beside,
      this.below, this._numbers);
    this._redraw = () => this._moment && this._draw(this._moment);
    window.addEventListener("themechange", this._redraw);
  }

  /** Load the drawings, and return a new screen. */
  static async open(spec) {
    return new Screen(spec, await openDrawings(spec));
  }

  /** Show a moment: its `step`, `action` (or null), `observation`, `reward`, `total`, `ending` and `answers`. */
  show(moment) {
    this._moment = moment;
    this._draw(moment);
    const { step, action, reward, total, ending, episode } = moment;
    setText(this._facts.episode, String(episode));
    setText(this._facts.step, String(step));
    setText(this._facts.action, action ? this.words(action, moment.observation) : "none yet");
    setText(this._facts.reward, step ? plain.format(reward) : "none yet");
    setText(this._facts.return, plain.format(total));
    setText(this._facts.state, ending || "in progress");
    this._answer(moment.answers ?? []);
    this._count();
  }

  /** Show the agent's answers: pairs of message and answer, each of which may be any text. */
  _answer(answers) {
    const messages = answers.map(([message]) => message).join("\n");
    if (messages !== this._messages) {
      this._messages = messages;
      this._asked.hidden = !answers.length;
      this._answers.replaceChildren(...answers.flatMap(([message]) =>
        [h("dt", {}, message), h("dd", { "data-answer": message, tabindex: "0" })]));
    }
    answers.forEach(([, answer], i) => setText(this._answers.children[2 * i + 1], answer));
  }

  /** Return an action in words. */
  words(action, observation) {
    return this._drawing(observation)?.words?.(action, observation) ?? inWords(action);
  }

  /** Close the screen. */
  close() {
    window.removeEventListener("themechange", this._redraw);
  }

  _drawing(observation) {
    return this._drawings.find((one) => one.shows(observation));
  }

  _draw({ observation, answers }) {
    let note = ["There is no drawing of this environment: below are its numbers.", ...this._problems].join(" ");
    let drawn = false;
    const drawing = this._drawing(observation);
    if (drawing) {
      try {
        this._size(drawing.width, drawing.height, drawing.pixelated ? "pixels" : "");
        drawing.draw(this._canvas.getContext("2d"), observation, marksIn(answers ?? []));
        this._canvas.setAttribute("aria-label", drawing.describe(observation));
        [note, drawn] = ["", true];
      } catch (error) {
        note = error.message;
      }
    }
    this._canvas.hidden = !drawn;
    setText(this._note, note);
    if (!drawn && this._names === null) this._numbers.open = true;
  }

  _size(wide, high, style) {
    const [width, height] = [wide, high].map((pixels) => Math.min(Math.max(Math.trunc(pixels), 1), MOST_PIXELS));
    if (this._canvas.width !== width || this._canvas.height !== height) {
      this._canvas.width = width;
      this._canvas.height = height;
    }
    this._canvas.className = style;
  }

  /** Update the table of numbers, if it is open. */
  _count() {
    if (!this._numbers.open || !this._moment) return;
    const { observation } = this._moment;
    const rows = numbersOf(observation, this._spec.observation, this._drawing(observation)?.names);
    const names = rows.map(([name]) => name).join();
    if (names !== this._names) {
      this._names = names;
      this._numbers.lastChild.remove();
      this._numbers.replaceChildren(h("summary", {}, "Observation in numbers"),
        table("Observation", ["number", "value", "range"], rows));
      this._cells = [...this._numbers.querySelectorAll("tbody tr")].map((row) => row.children[1]);
    } else {
      rows.forEach(([, value], i) => setText(this._cells[i], value));
    }
  }
}

/** Return the points that an agent wants drawn: its answer to "marks", if that is a JSON list of pairs of numbers. */
function marksIn(answers) {
  try {
    const pairs = JSON.parse(answers.find(([message]) => message === "marks")[1]);
    const isPair = (pair) => pair.length === 2 && pair.every(Number.isFinite);
    return pairs.length <= MOST_MARKS && pairs.every(isPair) ? pairs : [];
  } catch {
    return []; // no such answer, or an answer of another form, which is shown next to the picture
  }
}

/** Return a row of name, value and range for every number of an observation; a drawing may supply the names. */
function numbersOf({ ints, doubles, chars }, space, names = {}) {
  const nameOf = (kind, i, otherwise) => names[kind]?.(i) ?? otherwise;
  const rows = [
    ...ints.map((value, i) => [nameOf("int", i, `int ${i}`), String(value), rangeOf(space?.ints, i)]),
    ...doubles.map((value, i) => [nameOf("double", i, `double ${i}`), String(value), rangeOf(space?.doubles, i)]),
  ];
  for (let i = 0; i < chars.length; i += LINE) {
    const part = chars.subarray(i, i + LINE);
    rows.push([nameOf("chars", i, `chars ${i} to ${i + part.length - 1}`), textOf(part), ""]);
  }
  const more = rows.length - MOST_ROWS;
  return more > 0 ? [...rows.slice(0, MOST_ROWS), [`and ${more} more`, "", ""]] : rows;
}

/** Return the range of number `i`; `runs` are pairs of a count of numbers and their range. */
function rangeOf(runs, i) {
  let left = i;
  for (const [repeat, range] of runs ?? []) {
    if (left < repeat) return range;
    left -= repeat;
  }
  return "";
}
