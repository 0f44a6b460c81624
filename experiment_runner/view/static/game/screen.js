// Moments in, canvas out: what an agent sees, beside it the action, reward and return, and below it all numbers.

import { get, h, setText, table } from "../dom.js";
import { HEIGHT, WIDTH, describe, drawScene, isScene, readScene } from "./mario.js";
import { mines, skeleton } from "./toys.js";
import { inWords, textOf } from "./values.js";

const MOST_ROWS = 600;
const LINE = 22; // chars in a row of the table, and in a row of Mario's tiles
const plain = new Intl.NumberFormat("en", { maximumFractionDigits: 4 });

let artwork = null;

/** Return what games are drawn with; without the sheet, and with a `problem`, if the server cannot make it. */
async function loadArtwork() {
  const found = await get("artwork");
  const response = await fetch("api/artwork.png");
  if (!response.ok) return { ...found, problem: (await response.json()).error };
  const options = { premultiplyAlpha: "none", colorSpaceConversion: "none" };
  return { ...found, sheet: await createImageBitmap(await response.blob(), options) };
}

/** A place in which moments are shown; `element` holds it. `spec` is the task spec, as the server describes it. */
export class Screen {
  constructor(spec, art) {
    this._spec = spec;
    this._art = art;
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
    this._redraw = () => this._moment && this._draw(this._moment.observation);
    window.addEventListener("themechange", this._redraw);
  }

  /** Return a new screen, once there is what it draws with. */
  static async open(spec) {
    artwork ??= loadArtwork();
    try {
      return new Screen(spec, await artwork);
    } catch (error) {
      artwork = null;
      throw error;
    }
  }

  /** Show a moment: its `step`, `action` (or null), `observation`, `reward`, `total`, `ending` and `answers`. */
  show(moment) {
    this._moment = moment;
    this._draw(moment.observation);
    const { step, action, reward, total, ending, episode } = moment;
    setText(this._facts.episode, String(episode));
    setText(this._facts.step, String(step));
    setText(this._facts.action, action ? this.words(action, moment.observation) : "none yet");
    setText(this._facts.reward, step ? plain.format(reward) : "none yet");
    setText(this._facts.return, plain.format(total));
    setText(this._facts.state, ending || "goes on");
    this._answer(moment.answers ?? []);
    this._count();
  }

  /** Show what the agent has answered: pairs of message and answer, both of which may be anything. */
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
    const [first, jump, run] = action.ints;
    const alone = action.doubles.length === 0 && action.chars.length === 0;
    const moves = this._toy(observation)?.moves;
    if (moves && alone && action.ints.length === 1 && first in moves) return moves[first];
    if (isScene(observation) && alone && action.ints.length === 3) {
      const held = [{ "-1": "left", 1: "right" }[first], jump && "jump", run && "run"].filter(Boolean);
      return held.join(", ") || "no button";
    }
    return inWords(action);
  }

  /** End it. */
  close() {
    window.removeEventListener("themechange", this._redraw);
  }

  _toy({ ints, doubles, chars }) {
    if (ints.length !== 1 || doubles.length || chars.length) return null;
    return { mines: mines(this._art.mines), skeleton }[this._spec.extra] ?? null;
  }

  _draw(observation) {
    let note = "";
    let drawn = true;
    const toy = this._toy(observation);
    if (isScene(observation) && this._art.sheet) {
      try {
        const scene = readScene(observation);
        this._size(WIDTH, HEIGHT, "pixels");
        drawScene(this._canvas.getContext("2d"), scene, this._art);
        this._canvas.setAttribute("aria-label", describe(scene));
      } catch (error) {
        [note, drawn] = [error.message, false];
      }
    } else if (toy) {
      this._size(toy.width, toy.height, "");
      toy.draw(this._canvas.getContext("2d"), observation.ints);
      this._canvas.setAttribute("aria-label", toy.describe(observation.ints));
    } else {
      drawn = false;
      note = isScene(observation) ? this._art.problem : "There is no drawing of this environment: below are its numbers.";
    }
    this._canvas.hidden = !drawn;
    setText(this._note, note);
    if (!drawn && this._names === null) this._numbers.open = true;
  }

  _size(width, height, style) {
    if (this._canvas.width !== width || this._canvas.height !== height) {
      this._canvas.width = width;
      this._canvas.height = height;
    }
    this._canvas.className = style;
  }

  /** Bring the table of numbers up to date, if somebody looks at it. */
  _count() {
    if (!this._numbers.open || !this._moment) return;
    const rows = numbersOf(this._moment.observation, this._spec.observation, isScene(this._moment.observation));
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

/** Return rows of the name, value and range of every number of an observation. */
function numbersOf({ ints, doubles, chars }, space, scene) {
  const rows = [
    ...ints.map((value, i) => [scene ? intName(i) : `int ${i}`, String(value), rangeOf(space?.ints, i)]),
    ...doubles.map((value, i) => [scene ? doubleName(i) : `double ${i}`, String(value), rangeOf(space?.doubles, i)]),
  ];
  for (let i = 0; i < chars.length; i += LINE) {
    const part = chars.subarray(i, i + LINE);
    rows.push([scene ? `tiles, row ${i / LINE}` : `chars ${i} to ${i + part.length - 1}`, textOf(part), ""]);
  }
  const more = rows.length - MOST_ROWS;
  return more > 0 ? [...rows.slice(0, MOST_ROWS), [`and ${more} more`, "", ""]] : rows;
}

const intName = (i) => (i === 0 ? "the camera's column" : `${["kind", "winged"][(i - 1) % 2]} of sprite ${Math.floor((i - 1) / 2)}`);

const doubleName = (i) => `${["x", "height", "horizontal speed", "vertical speed"][i % 4]} of sprite ${Math.floor(i / 4)}`;

/** Return the range of number `i`; `runs` are pairs of how many numbers have a range, and the range. */
function rangeOf(runs, i) {
  let left = i;
  for (const [repeat, range] of runs ?? []) {
    if (left < repeat) return range;
    left -= repeat;
  }
  return "";
}
