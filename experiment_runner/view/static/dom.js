// Builds the page. Text from a run is hostile: it becomes text nodes and attributes that cannot run, never markup.

/** Return a new element; `props` are attributes, `on...` listeners and `class`; children are nodes or text. */
export function h(tag, props = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** Set an element's text, unless it is the same already. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * Return a table inside a scrolling box; `columns` are names, `rows` lists of cells: text, numbers or nodes. As `cards`,
 * it has a card for each row where the window is narrow.
 */
export function table(caption, columns, rows, cards = false) {
  const head = h("tr", {}, ...columns.map((name, i) =>
    h("th", { scope: "col", class: rows.length && rows.every((row) => isNumber(row[i])) ? "number" : null }, name)));
  const body = rows.map((row) =>
    h("tr", {}, ...row.map((cell, i) =>
      h(i ? "td" : "th", { scope: i ? null : "row", class: cell === "-" ? "number none" : isNumber(cell) ? "number" : null,
        "data-label": cards ? columns[i] : null }, cell))));
  const title = h("caption", {}, caption);
  return h("div", { class: cards ? "scroll cards" : "scroll", tabindex: "0", role: "region", "aria-label": caption },
    h("table", {}, title, h("thead", {}, head), h("tbody", {}, ...body)));
}

function isNumber(cell) {
  return typeof cell === "string" && /^[-+−]?[\d,.]+( (to|\/) [-+−]?[\d,.]+| \([\d.]+\))?%?( \(!\))?$|^-$/.test(cell);
}

const plain = new Intl.NumberFormat("en");
const fixed = new Intl.NumberFormat("en", { minimumFractionDigits: 2, maximumFractionDigits: 2 });

/** Return a whole number in readable form. */
export const count = (value) => plain.format(value);

/** Return a return or score in readable form, as in glue-results; a missing number is "-". */
export const score = (value) => (value === null || value === undefined ? "-" : fixed.format(value));

/** Return a time in seconds since 1970 in readable form, in the local time zone. */
export const date = (seconds) =>
  seconds === null ? "" : new Date(seconds * 1000).toLocaleString("sv").slice(0, 16);

/** Return a number of seconds in readable form. */
export function duration(seconds) {
  const whole = Math.round(seconds);
  const hours = Math.floor(whole / 3600);
  const minutes = Math.floor((whole % 3600) / 60);
  if (hours) return `${count(hours)} h ${String(minutes).padStart(2, "0")} min`;
  return minutes ? `${minutes} min ${String(whole % 60).padStart(2, "0")} s` : `${whole} s`;
}

/** Return the server's answer to a GET; throws an `Error` whose message says what is wrong. */
export async function get(path, query = {}, signal = undefined) {
  const search = new URLSearchParams();
  for (const [name, value] of Object.entries(query)) {
    for (const one of [value].flat()) search.append(name, one);
  }
  return answer(await ask(`api/${path}?${search}`, { signal }));
}

/** Send a value, and return the server's answer; throws an `Error` whose message says what is wrong. */
export const put = async (path, value) =>
  answer(await ask(`api/${path}`, { method: "PUT", headers: { "Content-Type": "application/json" }, body: JSON.stringify(value) }));

/** Return the response to a request; throws an `Error` that says why there is none. */
async function ask(address, options) {
  try {
    return await fetch(address, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Error("The server does not answer: it has ended, or this machine is too busy.");
  }
}

async function answer(response) {
  const type = response.headers.get("Content-Type") ?? "";
  const body = type.startsWith("application/json") ? await response.json() : { error: await response.text() };
  if (!response.ok) throw new Error(body.error);
  return body;
}

/** Parse a drawing from the server, which holds no text of a run; return its element, an image with a label if one is given. */
export function drawing(text, label) {
  const element = document.importNode(new DOMParser().parseFromString(text, "image/svg+xml").documentElement, true);
  if (label) element.setAttribute("role", "img");
  if (label) element.setAttribute("aria-label", label);
  return element;
}

/** Return the legend of drawings: a sample of each curve, and its name. */
export const legend = (entries) =>
  h("ul", { class: "legend" }, ...entries.map(({ name, sample }) => h("li", {}, drawing(sample), " ", name)));

/** Return a paragraph that stands where something is being loaded. */
export const loading = () => h("p", { class: "quiet", role: "status" }, "Loading …");

/** Return the seed of a trial, of up to 19 digits, as a short text; its title has all of them. */
export const seed = (digits) => (digits.length < 10 ? digits : h("abbr", { title: digits }, `${digits.slice(0, 3)}…${digits.slice(-3)}`));

/** Return a paragraph that says what went wrong. */
export const failure = (error) => h("p", { class: "failure", role: "alert" }, String(error.message ?? error));
