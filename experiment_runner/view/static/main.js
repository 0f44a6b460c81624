// The frame of the page. Each view is a module with `mount(element, params)`, which returns an unmount function;
// `params.path` holds the parts after the view's name in the address, `params.query` its URLSearchParams.

import { failure, h, setText } from "./dom.js";
import { watchConnection } from "./stream.js";

const VIEWS = { runs: "Runs", run: "Run", curves: "Curves", game: "Game", standings: "Standings" };
const CONNECTION = { live: "live", connecting: "connecting …",
  lost: "no connection: the server has ended, or was started again; open the address that it prints" };

const view = document.getElementById("view");
let unmount = null;
let turn = 0;
let shown = "";

/** Return the name and parameters of the view at an address such as "#/game/ID/3?step=7". */
function parse(hash) {
  const [path, query = ""] = hash.replace(/^#\/?/, "").split("?", 2);
  const [name, ...rest] = path.split("/");
  return { name: name in VIEWS ? name : "runs", path: rest.map(decode), query: new URLSearchParams(query) };
}

function decode(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

async function go() {
  const { name, path, query } = parse(location.hash);
  const mine = ++turn;
  const { mount } = await import(`./${name}.js`);
  if (mine !== turn) return;
  unmount?.();
  unmount = null;
  view.replaceChildren();
  view.className = `view-${name}`;
  document.title = `${VIEWS[name]} - glue-view`;
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

document.getElementById("navigation").append(
  h("a", { href: "#/runs", "data-view": "runs" }, "Runs"),
  h("a", { href: "#/curves", "data-view": "curves" }, "Curves"),
);
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  view.focus();
});
watchConnection((state) => {
  const label = document.getElementById("connection");
  label.dataset.state = state;
  setText(label, CONNECTION[state]);
});
window.addEventListener("hashchange", go);
go();
