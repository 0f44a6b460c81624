// The mines and the skeleton's walk on the page of runs, drawn simply, in the page's colors.

const CELL = 48; // pixels
const STATES = 21;

const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

function disc(context, x, y, radius, fill) {
  context.fillStyle = fill;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
}

function letter(context, text, x, y, fill) {
  context.fillStyle = fill;
  context.font = "bold 24px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.fillText(text, x, y);
}

/** Return the drawing of the environment that a task spec names; see docs/view.md for what a drawing is. */
export async function open({ extra }, file) {
  if (extra === "skeleton") return skeleton;
  return extra === "mines" ? mines(await (await file("map.json")).json()) : null;
}

const isState = ({ ints, doubles, chars }) => ints.length === 1 && !doubles.length && !chars.length;
const wordOf = (moves) => (action) => (isState(action) ? moves[action.ints[0]] : undefined);

/** Return a drawing of the mines with this map, a list of rows. */
const mines = (map) => ({
  width: CELL * map[0].length,
  height: CELL * map.length,
  shows: isState,
  words: wordOf(["up", "down", "left", "right"]),
  draw(context, { ints: [field] }) {
    context.fillStyle = color("card");
    context.fillRect(0, 0, this.width, this.height);
    map.forEach((line, row) => Array.from(line, (what, column) => {
      const [x, y] = [CELL * column, CELL * row];
      context.strokeStyle = color("line");
      context.strokeRect(x + 0.5, y + 0.5, CELL, CELL);
      if (what === "*") letter(context, "✱", x + CELL / 2, y + CELL / 2, color("bad"));
      if (what === "G") letter(context, "⚑", x + CELL / 2, y + CELL / 2, color("good"));
    }));
    disc(context, CELL * (field % map[0].length + 0.5), CELL * (Math.floor(field / map[0].length) + 0.5), CELL / 3, color("accent"));
  },
  describe({ ints: [field] }) {
    const [row, column] = [Math.floor(field / map[0].length), field % map[0].length];
    const on = { "*": ", on a mine", G: ", at the goal" }[map[row]?.[column]] ?? "";
    return `row ${row + 1}, column ${column + 1} of the mines${on}`;
  },
});

/** The skeleton's walk along 21 states. */
const skeleton = {
  width: CELL * STATES,
  height: 3 * CELL,
  shows: isState,
  words: wordOf(["down", "up"]),
  draw(context, { ints: [state] }) {
    context.fillStyle = color("card");
    context.fillRect(0, 0, this.width, this.height);
    context.strokeStyle = color("quiet");
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(CELL / 2, CELL * 1.5);
    context.lineTo(this.width - CELL / 2, CELL * 1.5);
    context.stroke();
    for (let i = 0; i < STATES; i++) disc(context, CELL * (i + 0.5), CELL * 1.5, 6, color("quiet"));
    letter(context, "−1", CELL / 2, CELL * 0.7, color("bad"));
    letter(context, "+1", this.width - CELL / 2, CELL * 0.7, color("good"));
    disc(context, CELL * (state + 0.5), CELL * 1.5, CELL / 3, color("accent"));
  },
  describe: ({ ints: [state] }) => `state ${state} of 0 to 20`,
};
