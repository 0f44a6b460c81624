// Observations and actions: ints, doubles and chars, as they cross the wire (glue/types.py).

const PREFIX = 16;

/** Return the value whose body begins at `at` of a DataView; `end` is where it ends. */
export function decode(view, at) {
  const [ints, doubles, chars] = [0, 4, 8].map((offset) => view.getUint32(at + offset, true));
  const first = at + PREFIX;
  const second = first + 8 * doubles;
  const third = second + 4 * ints;
  return {
    doubles: Array.from({ length: doubles }, (_, i) => view.getFloat64(first + 8 * i, true)),
    ints: Array.from({ length: ints }, (_, i) => view.getInt32(second + 4 * i, true)),
    chars: new Uint8Array(view.buffer, view.byteOffset + third, chars),
    end: third + chars,
  };
}

/** Return where the body that begins at `at` ends. */
export function endOf(view, at) {
  return at + PREFIX + 4 * view.getUint32(at, true) + 8 * view.getUint32(at + 4, true) + view.getUint32(at + 8, true);
}

/** Return chars as text: a dot for each that cannot be printed. */
export const textOf = (chars) =>
  Array.from(chars, (code) => (code >= 32 && code < 127 ? String.fromCharCode(code) : "·")).join("");

/** Return a value in a line, for people. */
export function inWords({ ints, doubles, chars }) {
  const parts = [...ints, ...doubles].map(String);
  if (chars.length) parts.push(`"${textOf(chars)}"`);
  return parts.join(", ") || "nothing";
}
