// The masks that a task spec has room for.

import { MAX_BESIDE } from "./extras.js";

const INTS = /ACTIONS(?:(?!REWARDS).)*?INTS\s*((?:\([^)]*\)\s*)*)/is;
const RANGE = /^\(\s*(?:(\d{1,6})\s+)?(-?\d{1,10})\s+(-?\d{1,10})\s*\)\s*/;

/** The number of values of each int of an action; none if the task spec does not say all in whole numbers. @param {string} taskSpec */
export function maskSizes(taskSpec) {
  /** @type {number[]} */
  const sizes = [];
  for (let rest = INTS.exec(taskSpec)?.[1] ?? ""; rest !== ""; ) {
    const [range, count = "1", low, high] = RANGE.exec(rest) ?? [""];
    const size = Number(high) - Number(low) + 1;
    if (!(size > 0) || sizes.length + Number(count) > 8 * MAX_BESIDE) return [];
    for (let left = Number(count); left > 0; left -= 1) sizes.push(size);
    rest = rest.slice(range.length);
  }
  return sizes;
}

/**
 * Why a mask does not fit ints of so many values; "" if it does, or if nothing is known of them.
 *
 * @param {ArrayLike<boolean | number>} mask @param {number[]} sizes
 */
export function maskFault(mask, sizes) {
  if (mask.length === 0 || sizes.length === 0) return "";
  const values = sizes.reduce((sum, size) => sum + size);
  const legal = Array.from(mask, Boolean);
  if (legal.length < values || legal.length > 8 * Math.ceil(values / 8) || legal.includes(true, values)) {
    return `it is of ${legal.length} values, and the ints of an action have ${values}`;
  }
  let at = 0;
  const empty = sizes.findIndex((size) => !legal.slice(at, (at += size)).includes(true));
  return empty < 0 ? "" : `no value of int ${empty} is legal`;
}
