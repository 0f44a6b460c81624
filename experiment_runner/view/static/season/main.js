// The page of a season: its board, its entrants, and replays of their verified attempts.

import { h, setText } from "../dom.js";
import { start } from "../frame.js";
import { watch, watchConnection } from "./data.js";

const CONNECTION = { live: "live", connecting: "connecting …", lost: "no connection: this is the last that was heard" };

document.getElementById("navigation").append(
  h("a", { href: "#/board", "data-view": "board" }, "Board"),
  h("a", { href: "feed.xml" }, "Feed"),
);
watchConnection((state) => {
  const label = document.getElementById("connection");
  label.dataset.state = state;
  setText(label, CONNECTION[state]);
});
watch((board) => setText(document.getElementById("season"), board.season));
start({ board: "Board", entrant: "Entrant", replay: "Replay" }, "season", "./season");
