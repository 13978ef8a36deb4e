// @ts-check
/** The states before and after a change: the line between their pictures, and what changes at a point. */

import { dot } from "../module/vectors.mjs";
import { duration, hoursOf, nowOf } from "./answer.mjs";
import { fill } from "./words.mjs";

/** @typedef {import("./words.mjs").Words} Words */

// The states of a scene that changes
export const BEFORE = 0;
export const AFTER = 1;

const STEPS = /** @type {Record<string, number>} */ ({
  ArrowLeft: -0.02,
  ArrowDown: -0.02,
  ArrowRight: 0.02,
  ArrowUp: 0.02,
  PageDown: -0.1,
  PageUp: 0.1,
  Home: -1,
  End: 1,
});

const PARALLEL = 0.999; // the least cosine between normals of surfaces that count as the same

export class Divider {
  /**
   * @param {HTMLElement} handle a slider
   * @param {HTMLElement} before the picture that is cut at the line
   * @param {HTMLElement[]} names of both sides
   * @param {Words} words
   */
  constructor(handle, before, names, words) {
    this.handle = handle;
    this.before = before;
    this.names = names;
    this.words = words;
    this.share = 0.5;
    handle.setAttribute("aria-label", words.divider);
    [names[0].textContent, names[1].textContent] = [words.before, words.after];
    for (const each of [handle, before, ...names]) each.hidden = false;
    handle.addEventListener("pointerdown", (event) => handle.setPointerCapture(event.pointerId));
    handle.addEventListener("pointermove", (event) => {
      if (!handle.hasPointerCapture(event.pointerId)) return;
      const box = /** @type {HTMLElement} */ (handle.parentElement).getBoundingClientRect();
      this.move((event.clientX - box.left) / box.width);
    });
    handle.addEventListener("keydown", (event) => {
      const step = STEPS[event.key];
      if (step === undefined) return;
      event.preventDefault();
      this.move(this.share + step);
    });
    this.move(this.share);
  }

  /**
   * The state that is shown at a place of the picture.
   * @param {number} x pixels from its left edge
   */
  stateAt(x) {
    return x < this.share * this.before.clientWidth ? BEFORE : AFTER;
  }

  /** @param {number} share of the picture's width that shows the state before */
  move(share) {
    this.share = Math.round(1000 * Math.max(0, Math.min(1, share))) / 1000;
    const [before, after] = [this.share, 1 - this.share].map((each) => Math.round(100 * each));
    this.handle.style.left = `${100 * this.share}%`;
    this.before.dataset.share = String(this.share);
    this.before.style.clipPath = `inset(0 ${100 - 100 * this.share}% 0 0)`;
    this.handle.setAttribute("aria-valuenow", String(before));
    this.handle.setAttribute("aria-valuetext", fill(this.words.dividerAt, { before, after }));
    this.names.forEach((name, k) => {
      name.style.visibility = [before, after][k] > 8 ? "visible" : "hidden";
    });
  }
}

/**
 * Ask about a point in both states. A surface of the other state that lies in this one, but has other triangles, counts
 * as the same.
 * @param {(question: any) => Promise<any>} ask
 * @param {any} question about a ray
 * @param {number} shown the state that the ray meets: 0 before, 1 after
 * @param {Uint8Array} states of each face: bit 0 before, bit 1 after
 * @param {number} reach how far surfaces that count as the same may be apart
 * @returns {Promise<any[]>} what is found before and after; null where the surface does not exist
 */
export async function askBoth(ask, question, shown, states, reach) {
  const [found, other] = [[null, null], 1 - shown];
  const spot = /** @type {any} */ (await ask({ ...question, state: shown }));
  found[shown] = spot;
  if (!spot) return found;
  if (states[spot.face] & (1 << other)) found[other] = await ask({ ...question, state: other, at: spot });
  else {
    const { point, normal } = spot;
    const origin = point.map((/** @type {number} */ p, /** @type {number} */ k) => p + reach * normal[k]);
    const direction = normal.map((/** @type {number} */ n) => -n);
    const near = await ask({ ...question, origin, direction, state: other });
    const apart = near && dot(origin, direction) - dot(near.point, direction);
    if (near && Math.abs(apart) <= 2 * reach && dot(near.normal, normal) > PARALLEL) found[other] = near;
  }
  return found;
}

/**
 * A sentence.
 * @param {any[]} found before and after
 * @param {import("./answer.mjs").Day | null} day null: without a place, only the sun that is shown
 * @param {number | null} altitude of the sun that is shown, degrees; null: none shines
 * @param {Words} words
 * @param {(face: number) => string} nameOf an object, or ""
 */
export function changeOf([first, second], day, altitude, words, nameOf) {
  if (!first && !second) return "";
  if (!first) return words.notBefore;
  if (!second) return words.notAfter;
  if (!day && altitude === null) return "";
  if (!day) {
    const [before, after] = [first, second].map((each) => nowOf(each, altitude, words, nameOf));
    return fill(words.sunStates, { before, after });
  }
  const [before, after] = [hoursOf(day, first.states), hoursOf(day, second.states)];
  const phrase = before > after ? words.lost : before < after ? words.gained : words.same;
  const [was, is, change] = [before, after, Math.abs(before - after)].map(duration);
  return fill(phrase, { before: was, after: is, change });
}
