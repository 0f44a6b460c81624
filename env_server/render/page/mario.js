// Infinite Mario on the page of runs, pixel for pixel as env_server/render/drawing.py draws it.

const ROWS = 16;
const COLUMNS = 21;
const TILE = 16;
const MOST_SPRITES = 1000;
const FAR = 1e6;
const PLANT = 5;
const NAMES = { 1: "ledge", 3: "ledge", b: "brick", "?": "question", $: "coin" };
const MOUNTAINS = [{ top: 110, nearness: 0.2 }, { top: 150, nearness: 0.35 }];
const CLOUDS = [26, 58, 14, 44];
const KINDS = { 0: "Mario", 10: "large Mario", 11: "fire Mario", 1: "red koopa", 2: "green koopa", 3: "goomba",
  4: "spiky", 5: "piranha plant", 6: "mushroom", 7: "fire flower", 8: "fireball", 9: "shell" };

const WIDTH = 320;
const HEIGHT = 240;

/** Return the drawing of Infinite Mario; see docs/view.md for what a drawing is. */
export async function open(spec, file) {
  const art = await (await file("artwork.json")).json();
  const options = { premultiplyAlpha: "none", colorSpaceConversion: "none" };
  let sheet = null;
  let problem = null;
  try {
    sheet = await createImageBitmap(await (await file("sheet.png")).blob(), options);
  } catch (error) {
    problem = error;
  }
  return {
    width: WIDTH,
    height: HEIGHT,
    pixelated: true,
    shows: isScene,
    draw(context, observation, marks) {
      if (problem) throw problem;
      drawScene(context, readScene(observation), marks, { ...art, sheet });
    },
    describe: (observation) => describe(readScene(observation)),
    words({ ints: [direction, jump, run] }) {
      const held = [{ "-1": "left", 1: "right" }[direction], jump && "jump", run && "run"].filter(Boolean);
      return held.join(", ") || "no button";
    },
    names: {
      int: (i) => (i ? `${["kind", "winged"][(i - 1) % 2]} of sprite ${Math.floor((i - 1) / 2)}` : "the camera's column"),
      double: (i) => `${["x", "height", "horizontal speed", "vertical speed"][i % 4]} of sprite ${Math.floor(i / 4)}`,
      chars: (i) => `tiles, row ${i / (COLUMNS + 1)}`,
    },
  };
}

/** Return whether an observation has the counts of one of Infinite Mario. */
const isScene = ({ ints, doubles, chars }) =>
  ints.length >= 3 && ints.length % 2 === 1 && doubles.length === 2 * (ints.length - 1) && chars.length === ROWS * (COLUMNS + 1);

/** Return what an observation shows; an `Error` if no level can look like that. */
function readScene({ ints, doubles, chars }) {
  const sprites = [];
  for (let i = 0; 4 * i < doubles.length; i++) {
    const [x, height, speedX] = doubles.slice(4 * i, 4 * i + 3);
    sprites.push({ kind: ints[1 + 2 * i], winged: ints[2 + 2 * i] === 1, x, height, speedX });
  }
  if (sprites.length > MOST_SPRITES || !doubles.every((value) => Math.abs(value) < FAR)) {
    throw new Error("This observation has more sprites, or farther ones, than Infinite Mario can have.");
  }
  const tiles = Array.from(chars, (code) => (code >= 32 && code < 127 ? String.fromCharCode(code) : " ")).join("");
  const rows = Array.from({ length: ROWS }, (_, i) => tiles.slice(i * (COLUMNS + 1), i * (COLUMNS + 1) + COLUMNS));
  return { column: ints[0], rows, sprites };
}

/** Return, in words, where Mario is and what is in sight. */
function describe(scene) {
  const [mario, ...others] = scene.sprites;
  const near = others.filter(({ x }) => x >= scene.column && x < scene.column + COLUMNS);
  const names = near.map(({ kind, winged }) => `${winged ? "winged " : ""}${KINDS[kind] ?? "something unknown"}`);
  return `${KINDS[mario.kind] ?? "Mario"} at column ${mario.x.toFixed(1)}, height ${mario.height.toFixed(1)}` +
    `; in sight: ${names.join(", ") || "nobody"}`;
}

/** Draw a scene, and marks at pairs of x and height; `art` has the `sheet`, the `places` in it, and `colors`. */
function drawScene(context, scene, marks, art) {
  const rows = outlined(scene);
  const x = Math.max(scene.sprites[0].x - WIDTH / 2 / TILE, scene.column);
  const camera = roundHalfEven(Math.min(x, scene.column + COLUMNS - WIDTH / TILE) * TILE);
  const paste = (name, left, top) => {
    const place = art.places[name];
    if (place) context.drawImage(art.sheet, ...place, left, top, place[2], place[3]);
  };
  const sprite = ({ kind, winged, x: at, height, speedX }) => {
    const name = `sprite ${kind} ${speedX < 0 ? "left" : "right"}${winged ? " winged" : ""}`;
    const [, , wide, high] = art.places[name] ?? [0, 0, 0, 0];
    const feet = roundHalfEven(HEIGHT + TILE - height * TILE) + 1;
    paste(name, roundHalfEven(at * TILE) - camera - Math.floor(wide / 2), feet - high);
  };
  background(context, camera, art.colors, paste);
  // Plants rise out of pipes, which are therefore drawn over them.
  scene.sprites.filter(({ kind }) => kind === PLANT).forEach(sprite);
  for (let row = 0; row < HEIGHT / TILE; row++) {
    for (let column = 0; column < COLUMNS; column++) {
      for (const name of tilesOf(rows, row, column)) {
        paste(`tile ${name}`, (scene.column + column) * TILE - camera, row * TILE);
      }
    }
  }
  const [, , wide, high] = art.places.mark;
  for (const [x, height] of marks) {
    paste("mark", roundHalfEven(x * TILE) - camera - Math.floor(wide / 2),
      roundHalfEven(HEIGHT + TILE - height * TILE) - Math.floor(high / 2));
  }
  scene.sprites.filter(({ kind }) => kind !== PLANT).reverse().forEach(sprite);
}

function background(context, camera, colors, paste) {
  colors.sky.forEach((color, i) => {
    context.fillStyle = color;
    context.fillRect(0, 28 * i, WIDTH, HEIGHT - 28 * i);
  });
  MOUNTAINS.forEach(({ top, nearness }, i) => {
    context.fillStyle = colors.mountains[i];
    for (let column = 0; column < WIDTH; column++) {
      const far = column + camera * nearness;
      const crest = Math.ceil(top - 22 * Math.sin(far / 53) - 11 * Math.sin(far / 23 + 1));
      context.fillRect(column, crest, 1, HEIGHT - crest);
    }
  });
  CLOUDS.forEach((height, i) => {
    const drifted = Math.trunc(130 * i - camera * 0.12) % 520;
    paste("cloud", (drifted < 0 ? drifted + 520 : drifted) - 100, height);
  });
}

/** Return the rows with "#" for the inside of the ground, and ground where the goal's column hides it. */
function outlined(scene) {
  const rows = scene.rows.map((line) => Array.from(line, (cell, column) => (isGround(line, column) ? "7" : cell)));
  for (const [row, column] of buried(scene)) rows[row][column] = "#";
  return rows;
}

/** Return the cells inside the ground: blank ones that the air around Mario does not reach. */
function buried({ column: left, rows, sprites: [mario] }) {
  const clamp = (value, most) => Math.min(Math.max(value, 0), most);
  const first = [clamp(ROWS - 1 - Math.trunc(mario.height), ROWS - 1), clamp(Math.trunc(mario.x) - left, COLUMNS - 1)];
  const reached = new Set([first[0] * COLUMNS + first[1]]);
  const edge = [first];
  while (edge.length) {
    const [row, column] = edge.pop();
    for (const [r, c] of [[row - 1, column], [row + 1, column], [row, column - 1], [row, column + 1]]) {
      const inside = r >= 0 && r < ROWS && c >= 0 && c < COLUMNS;
      if (inside && !reached.has(r * COLUMNS + c) && !isGround(rows[r], c)) {
        reached.add(r * COLUMNS + c);
        edge.push([r, c]);
      }
    }
  }
  const cells = rows.flatMap((line, row) => Array.from(line, (_, column) => [row, column]));
  return cells.filter(([row, column]) => " !".includes(rows[row][column]) &&
    !reached.has(row * COLUMNS + column) && !isGround(rows[row], column));
}

const isGround = (line, column) => line[column] === "7" ||
  (line[column] === "!" && line.slice(Math.max(0, column - 1), column + 2).includes("7"));

const isSolid = (cell) => cell === "7" || cell === "#";

/** Return the names of the tiles that a cell is drawn with, the one behind first. */
function tilesOf(rows, row, column) {
  const cell = rows[row][column];
  const names = !isSolid(cell) && onHill(rows, row, column) ? ["hill"] : [];
  if (cell === "#") names.push("earth");
  else if (cell === "7") names.push(solidTile(rows, row, column));
  else if (cell === "|") names.push(pipeTile(rows, row, column));
  else if (cell === "!" && row > 2) names.push({ 3: "pole top", 4: "flag" }[row] ?? "pole");
  else if (cell in NAMES) names.push(NAMES[cell]);
  return names;
}

/** Return whether a ledge above makes this cell part of a hill. */
function onHill(rows, row, column) {
  for (let above = row - 1; above >= 0; above--) {
    const cell = rows[above][column];
    if (cell === "1" || isSolid(cell)) return cell === "1";
  }
  return false;
}

/** Return the look of a solid cell: ground and what lies on it, ceiling, or a block in the air. */
function solidTile(rows, row, column) {
  const line = rows.map((cells) => cells[column]);
  if (line.slice(row).every(isSolid)) return row && isSolid(line[row - 1]) ? "earth" : "grass";
  return line.slice(0, row).every(isSolid) ? "earth" : "stone";
}

function pipeTile(rows, row, column) {
  const line = rows[row];
  let start = column;
  let end = column;
  while (start > 0 && line[start - 1] === "|") start--;
  while (end < line.length && line[end] === "|") end++;
  // Pipes are two tiles wide; the window's left border may cut one.
  const cut = start === 0 && (end - start) % 2 ? 1 : 0;
  const mouth = row === 0 || rows[row - 1][column] !== "|";
  return `${mouth ? "mouth" : "shaft"} ${["left", "right"][(column - start + cut) % 2]}`;
}

/** Round as Python does: halves to the even neighbor. */
function roundHalfEven(value) {
  const low = Math.floor(value);
  const rest = value - low;
  return low + (rest > 0.5 || (rest === 0.5 && low % 2 !== 0) ? 1 : 0);
}
