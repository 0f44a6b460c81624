// Plays a recorded episode on a screen: buttons, keys, speed, and a scrubber with the rewards on it.

import { h, score, setText } from "../dom.js";

const SPEEDS = [1, 2, 5, 10, 15, 30, 60, 120];
const USUAL_SPEED = 10; // steps per second, as in glue-replay
const PAGE = 10;
const STRIP = 56;
const LONGEST_FRAME = 250; // milliseconds; more have passed if the tab was hidden
const SAVE_AFTER = 300;

/**
 * Show `recording` on `screen`, from `step` on; `moved(step)` is called when the player rests at a step.
 *
 * Returns `element`, `go(step)`, and `close()`, which stops the player.
 */
export function play(screen, recording, step, moved) {
  const last = recording.length - 1;
  let at = -1;
  let timer = null;
  let frame = 0;
  let before = 0;
  let rest = 0;

  const button = (label, text, action) => h("button", { type: "button", "aria-label": label, title: label, onclick: action }, text);
  const toggle = button("Play", "▶", () => (frame ? pause() : start()));
  toggle.classList.add("primary");
  const speed = h("select", { id: "speed" }, ...SPEEDS.map((one) => h("option", { value: one, selected: one === USUAL_SPEED }, String(one))));
  const slider = h("input", { type: "range", min: "0", max: String(last), step: "1", "aria-label": "Step", oninput: () => seek(Number(slider.value)) });
  const strip = h("canvas", { class: "strip", "aria-hidden": "true" });
  const label = h("output", { class: "at" });
  const spoken = h("p", { class: "spoken", role: "status", "aria-live": "polite" });
  const usual = commonest(recording.rewards.subarray(1));
  const element = h("div", { class: "player" },
    h("div", { class: "timeline" }, strip, slider),
    h("div", { class: "controls" },
      button("First step", "«", () => seek(0)), button("One step back", "‹", () => seek(at - 1)), toggle,
      button("One step on", "›", () => seek(at + 1)), button("Last step", "»", () => seek(last)),
      button("Next reward that is not the usual one", "★", nextReward),
      h("label", { for: "speed" }, "speed"), speed, h("span", {}, "steps/s"), label),
    spoken,
    h("p", { class: "quiet" }, "Keys: space plays and pauses, ← and → go a step, Page Up and Page Down ten, Home and End to the ends."));

  function show(next) {
    next = Math.min(Math.max(next, 0), last);
    if (next === at) return;
    at = next;
    const moment = { ...recording.moment(at), episode: recording.about.episode };
    screen.show(moment);
    slider.value = String(at);
    const reward = at ? `, reward ${score(moment.reward)}` : "";
    slider.setAttribute("aria-valuetext", `step ${at} of ${last}${reward}, return ${score(moment.total)}`);
    setText(label, `${at} / ${last}`);
    drawStrip();
    clearTimeout(timer);
    if (!frame) timer = setTimeout(rested, SAVE_AFTER);
  }

  function rested() {
    moved(at);
    setText(spoken, slider.getAttribute("aria-valuetext"));
  }

  function seek(next) {
    pause();
    show(next);
  }

  function start() {
    if (at === last) show(0);
    clearTimeout(timer);
    before = performance.now();
    rest = 0;
    frame = requestAnimationFrame(advance);
    setToggle("Pause", "❚❚");
  }

  function pause() {
    if (!frame) return;
    cancelAnimationFrame(frame);
    frame = 0;
    setToggle("Play", "▶");
    rested();
  }

  function advance(now) {
    rest += Math.min(Math.max(now - before, 0), LONGEST_FRAME) * Number(speed.value) / 1000;
    before = now;
    const steps = Math.floor(rest);
    rest -= steps;
    if (steps) show(at + steps);
    if (at === last) pause();
    else frame = requestAnimationFrame(advance);
  }

  function setToggle(name, text) {
    toggle.setAttribute("aria-label", name);
    toggle.title = name;
    setText(toggle, text);
  }

  function nextReward() {
    const next = recording.rewards.findIndex((reward, i) => i > at && reward !== usual);
    seek(next < 0 ? last : next);
  }

  // One bar per pixel: its largest reward above the line, its smallest below; square roots keep small rewards visible.
  let bars = null;
  function measure() {
    const width = Math.max(strip.clientWidth, 1);
    if (bars?.length === width) return;
    strip.width = width;
    strip.height = STRIP;
    let most = 0;
    for (const reward of recording.rewards) if (Number.isFinite(reward)) most = Math.max(most, Math.abs(reward));
    bars = Array.from({ length: width }, () => [0, 0]);
    recording.rewards.forEach((reward, i) => {
      const bar = bars[place(i, width)];
      const tall = most && !Number.isNaN(reward) ? Math.sign(reward) * Math.sqrt(Math.min(Math.abs(reward) / most, 1)) : 0;
      bar[0] = Math.max(bar[0], tall);
      bar[1] = Math.min(bar[1], tall);
    });
  }

  const place = (i, width) => Math.round((last ? i / last : 0) * (width - 1));

  function drawStrip() {
    measure();
    const styles = getComputedStyle(document.documentElement);
    const context = strip.getContext("2d");
    const middle = STRIP / 2;
    const thick = Math.max(1, Math.min(4, Math.floor(strip.width / recording.length) - 1));
    context.clearRect(0, 0, strip.width, STRIP);
    context.fillStyle = styles.getPropertyValue("--line");
    context.fillRect(0, middle, strip.width, 1);
    for (const [color, side] of [["--good", 0], ["--bad", 1]]) {
      context.fillStyle = styles.getPropertyValue(color);
      bars.forEach((bar, x) => {
        const tall = Math.round(Math.abs(bar[side]) * (middle - 2));
        if (tall) context.fillRect(Math.max(0, x - (thick >> 1)), side ? middle + 1 : middle - tall, thick, tall);
      });
    }
    context.fillStyle = styles.getPropertyValue("--text");
    context.fillRect(Math.max(0, place(at, strip.width) - 1), 0, 2, STRIP);
  }

  function point(event) {
    if (!(event.buttons & 1)) return;
    const box = strip.getBoundingClientRect();
    seek(Math.round((event.clientX - box.left) / Math.max(box.width - 1, 1) * last));
  }

  function key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target.closest?.("select, .scroll, input:not([type=range])")) return;
    const steps = { ArrowLeft: at - 1, ArrowRight: at + 1, PageUp: at - PAGE, PageDown: at + PAGE, Home: 0, End: last };
    if (event.key === " ") {
      if (event.target.closest?.("button, a, summary")) return;
      if (!event.repeat) toggle.click();
    } else if (event.key in steps) seek(steps[event.key]);
    else return;
    event.preventDefault();
  }

  strip.addEventListener("pointerdown", point);
  strip.addEventListener("pointermove", point);
  document.addEventListener("keydown", key);
  const redraw = () => at >= 0 && drawStrip();
  const resized = new ResizeObserver(redraw);
  resized.observe(strip);
  window.addEventListener("themechange", redraw);
  show(step);
  return {
    element,
    go: seek,
    close() {
      clearTimeout(timer);
      cancelAnimationFrame(frame);
      resized.disconnect();
      document.removeEventListener("keydown", key);
      window.removeEventListener("themechange", redraw);
    },
  };
}

function commonest(values) {
  const counts = new Map();
  for (const value of values) counts.set(value, (counts.get(value) ?? 0) + 1);
  return [...counts].reduce((best, one) => (one[1] > best[1] ? one : best), [0, 0])[0];
}
