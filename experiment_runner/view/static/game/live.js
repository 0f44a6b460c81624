// A trial in progress, on the same screen as recorded episodes: always its newest moment.

import { count, failure, h, setText } from "../dom.js";
import { listen } from "../stream.js";
import { Screen } from "./screen.js";
import { decode } from "./values.js";

const NO_HUB = "What is being played cannot be watched: only trials with a hub on this machine can, so none of " +
  "--in-process, of a cluster, of a competition, or at a hub that asks for a key.";

/** Show a run's trials in progress in `element`; returns a function that stops it. */
export function watchLive(element, run) {
  const status = h("p", { class: "quiet", role: "status" });
  const choice = h("select", { id: "trial", onchange: () => follow(choice.value) });
  const chooser = h("p", { class: "controls", hidden: true }, h("label", { for: "trial" }, "trial"), choice);
  const place = h("div");
  const section = h("section", { class: "live", hidden: true }, h("h2", {}, "Live"), status, chooser, place);
  element.append(section);
  let screen = null;
  let spec = null;
  let opening = false;
  let newest = null;
  let answers = [];
  let frame = 0;
  let ended = false;
  let done = 0;
  let running = false;
  let wanted = "";
  let stop = null;

  const stopRuns = listen("runs", (changed, all) => {
    const state = all?.get(run);
    done = state?.episodes ?? 0;
    running = state?.state === "running";
    section.hidden = !running && !screen;
    if (running && !stop) follow("");
    else if (!running && stop) {
      stop();
      stop = null;
      setText(status, "The run is over: this was its last moment seen here.");
    }
  });

  function follow(trial) {
    wanted = trial;
    stop?.();
    stop = listen(trial ? `live:${run}/${trial}` : `live:${run}`, receive);
  }

  function receive(changed, all) {
    if (!all) {
      setText(status, "The page is watching as many trials as it can.");
      return;
    }
    const trials = all.get("trials") ?? [];
    const trial = all.get("trial");
    if ("trials" in changed) {
      chooser.hidden = trials.length < 2;
      choice.replaceChildren(...trials.map((one) => h("option", { value: one, selected: one === (wanted || trial) }, one)));
    }
    if (trial) setText(status, `${trial}: the latest moment, at most 30 a second; the game does not wait for the page.`);
    else if (trials.length) setText(status, "Waiting for the next trial.");
    else setText(status, NO_HUB);
    answers = all.get("answers") ?? [];
    if (all.get("spec")) open(all.get("spec"));
    if (changed.moment || changed.answers) {
      newest = changed.moment ?? newest;
      frame ||= requestAnimationFrame(draw);
    }
  }

  async function open(next) {
    if (opening || spec === next) return;
    opening = true;
    try {
      const opened = await Screen.open(next);
      if (ended) {
        opened.close();
        return;
      }
      screen?.close();
      [screen, spec] = [opened, next];
      place.replaceChildren(screen.element);
      if (newest) draw();
    } catch (error) {
      place.replaceChildren(failure(error));
    } finally {
      opening = false;
    }
  }

  function draw() {
    frame = 0;
    if (!screen || !newest) return;
    const { step, reward, return: total, ending, seen } = newest;
    if (seen === null) {
      setText(status, "What the agent sees here is too large to be shown live.");
      return;
    }
    const bytes = Uint8Array.from(atob(seen), (letter) => letter.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    const action = decode(view, 0);
    screen.show({ step, action: step ? action : null, observation: decode(view, action.end), reward: Number(reward),
      total: Number(total), ending, answers, episode: `after ${count(done)} of the run` });
  }

  return () => {
    ended = true;
    stopRuns();
    stop?.();
    cancelAnimationFrame(frame);
    screen?.close();
  };
}
