// Observations and actions: ints, doubles and chars, as they cross the wire (glue/types.py).

const PREFIX = 16;

/** Return the value whose body begins at offset `at` of a DataView; `end` is the offset after the body. */
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

/** Return the offset after the body that begins at `at`. */
export function endOf(view, at) {
  return at + PREFIX + 4 * view.getUint32(at, true) + 8 * view.getUint32(at + 4, true) + view.getUint32(at + 8, true);
}

/** Return chars as text, with a dot for each unprintable one. */
export const textOf = (chars) =>
  Array.from(chars, (code) => (code >= 32 && code < 127 ? String.fromCharCode(code) : "·")).join("");

/** Return a value as one readable line. */
export function inWords({ ints, doubles, chars }) {
  const parts = [...ints, ...doubles].map(String);
  if (chars.length) parts.push(`"${textOf(chars)}"`);
  return parts.join(", ") || "nothing";
}
