// Standings enlarged for a lecture hall, until Escape.

import { h } from "./dom.js";

/**
 * Return the `button` that switches it, and `close()`; `view` is the address of the view, whose query keeps the choice, and
 * `switched(isLarge)` is called when it was switched.
 */
export function projector(view, query, switched = () => {}) {
  const button = h("button", { type: "button", onclick: () => set(!document.body.classList.contains("projector")) }, "Projector");
  const leave = (event) => {
    if (event.key === "Escape") set(false);
  };

  function set(isLarge) {
    document.body.classList.toggle("projector", isLarge);
    button.setAttribute("aria-pressed", String(isLarge));
    history.replaceState(null, "", `${view}${isLarge ? "?projector=1" : ""}`);
    switched(isLarge);
  }

  document.addEventListener("keydown", leave);
  set(query.get("projector") === "1");
  return {
    button,
    close() {
      document.removeEventListener("keydown", leave);
      document.body.classList.remove("projector");
    },
  };
}
