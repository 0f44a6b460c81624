// The page of runs.

import { start } from "./frame.js";
import { h, setText } from "./dom.js";
import { watchConnection } from "./stream.js";

const CONNECTION = { live: "live", connecting: "connecting …",
  lost: "no connection: the server has ended, or was started again; open the address that it prints" };

document.getElementById("navigation").append(
  h("a", { href: "#/runs", "data-view": "runs" }, "Runs"),
  h("a", { href: "#/curves", "data-view": "curves" }, "Curves"),
);
watchConnection((state) => {
  const label = document.getElementById("connection");
  label.dataset.state = state;
  setText(label, CONNECTION[state]);
});
start({ runs: "Runs", run: "Run", curves: "Curves", game: "Game", standings: "Standings" }, "glue-view");
