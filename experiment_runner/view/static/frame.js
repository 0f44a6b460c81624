// The frame of a page: its views, its theme, its focus. Each view is a module with `mount(element, params)`, which returns an
// unmount function; `params.path` holds the parts after the view's name in the address, `params.query` its URLSearchParams.

import { failure } from "./dom.js";

const view = document.getElementById("view");

function decode(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

/** Show the view that the address names; `views` are titles by the names of modules in a folder, the usual one first. */
export function start(views, page, folder = ".") {
  let unmount = null;
  let turn = 0;
  let shown = "";

  /** Return the name and parameters of the view at an address such as "#/game/ID/3?step=7". */
  function parse(hash) {
    const [path, query = ""] = hash.replace(/^#\/?/, "").split("?", 2);
    const [name, ...rest] = path.split("/");
    return { name: name in views ? name : Object.keys(views)[0], path: rest.map(decode), query: new URLSearchParams(query) };
  }

  async function go() {
    const { name, path, query } = parse(location.hash);
    const mine = ++turn;
    const { mount } = await import(`${folder}/${name}.js`);
    if (mine !== turn) return;
    unmount?.();
    unmount = null;
    view.replaceChildren();
    view.className = `view-${name}`;
    document.title = `${views[name]} - ${page}`;
    for (const link of document.querySelectorAll("#navigation a")) {
      const current = link.dataset.view === name;
      if (current) link.setAttribute("aria-current", "page");
      else link.removeAttribute("aria-current");
    }
    try {
      unmount = await mount(view, { path, query });
    } catch (error) {
      view.append(failure(error));
    }
    // Moving the focus tells screen readers of the new view.
    if (shown && shown !== name) view.focus({ preventScroll: true });
    shown = name;
  }

  window.addEventListener("hashchange", go);
  go();
}

function theme(next) {
  document.documentElement.dataset.theme = next;
  window.dispatchEvent(new Event("themechange"));
}

function isDark() {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

const saved = localStorage.getItem("theme");
if (saved === "dark" || saved === "light") theme(saved);
document.getElementById("theme").addEventListener("click", () => {
  const next = isDark() ? "light" : "dark";
  localStorage.setItem("theme", next);
  theme(next);
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () =>
  window.dispatchEvent(new Event("themechange")));
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  view.focus();
});
