// @ts-check
/** Distances between two clicked places: their marks and the sentence. */

import { part } from "./parts.mjs";
import { fill } from "./words.mjs";

/** @typedef {import("./questions.mjs").Spot} Spot */
/** @typedef {import("./words.mjs").Words} Words */

const LEVEL = 0.005; // metres up to which two places are at one height
const STANDING = 0.5; // least upward part of the normal of surfaces on which one stands

/**
 * A length with its unit.
 * @param {number} metres
 * @param {Words} words
 */
function lengthText(metres, words) {
  const [value, unit] = metres >= 1000 ? [metres / 1000, "km"] : [metres, "m"];
  const digits = value < 100 ? 2 : 1;
  return `${value.toLocaleString(words.locale, { minimumFractionDigits: digits, maximumFractionDigits: digits })} ${unit}`;
}

/**
 * How far apart two places are, and whether they see each other.
 * @param {Spot} first
 * @param {Spot} second
 * @param {{up: string, metres: number}} about
 */
export function measured(first, second, { up, metres }) {
  const away = second.point.map((x, axis) => (x - first.point[axis]) * metres);
  const rise = away[up === "z" ? 2 : 1];
  return { length: Math.hypot(...away), level: Math.hypot(away[0], away[up === "z" ? 1 : 2]), rise };
}

/**
 * @param {{length: number, level: number, rise: number}} lengths
 * @param {number} eye metres above the first place
 * @param {{seen: boolean, blocker: number}} sight `sightline` of `questions.mjs`
 * @param {Words} words
 * @param {(face: number) => string} nameOf an object, or ""
 */
export function measureSentence({ length, level, rise }, eye, { seen, blocker }, words, nameOf) {
  const text = (/** @type {number} */ metres) => lengthText(metres, words);
  const height = text(Math.abs(rise));
  const step = Math.abs(rise) < LEVEL ? words.sameHeight : fill(rise > 0 ? words.higher : words.lower, { height });
  const apart = fill(words.apart, { length: text(length), level: text(level), step });
  const name = blocker >= 0 ? nameOf(blocker) : "";
  const from = eye > 0 ? fill(words.fromAbove, { height: text(eye) }) : words.fromFirst;
  return `${apart} ${fill(seen ? words.inView : name ? words.hiddenBy : words.hidden, { from, blocker: name })}`;
}

/**
 * The eye at a place: at the chosen height where one can stand, otherwise on the surface.
 * @param {Spot} spot
 * @param {any} about
 * @returns {import("./questions.mjs").Eye} its height in units of the scene
 */
export function eyeAt(spot, { up, metres }) {
  const stands = spot.normal[up === "z" ? 2 : 1] > STANDING;
  return { spot, height: stands ? Math.max(0, Number(part("eye").value)) / metres : 0 };
}

/** Show the height of the eye where it matters. */
export function showEye() {
  const measures = part("ruler").getAttribute("aria-pressed") === "true";
  part("eye").closest("label").hidden = !measures && part("show").value !== "seen";
}

/** Two places that are clicked one after the other while the button is pressed. */
export class Ruler {
  /** @type {Spot[]} */ #spots = [];

  /**
   * @param {any} about
   * @param {Words} words
   * @param {import("./pool.mjs").Pool} pool
   * @param {import("./orbit.mjs").Orbit} camera
   * @param {(face: number) => string} nameOf
   * @param {() => void} ended
   */
  constructor(about, words, pool, camera, nameOf, ended) {
    this.about = about;
    this.words = words;
    this.pool = pool;
    this.camera = camera;
    this.nameOf = nameOf;
    this.on = false;
    part("ruler").textContent = words.measure;
    part("ruler").addEventListener("click", () => {
      this.on = !this.on;
      part("ruler").setAttribute("aria-pressed", String(this.on));
      showEye();
      this.#spots = [];
      this.draw();
      if (this.on) part("answer").textContent = words.firstPlace;
      else ended();
    });
  }

  /** @param {import("./questions.mjs").Click} click */
  async clicked(click) {
    const spot = await this.pool.run("spot", click, true);
    if (!this.on) return;
    if (!spot) {
      part("answer").textContent = this.words.nothing;
      return;
    }
    const first = this.#spots.length === 1 ? this.#spots[0] : null;
    this.#spots = first ? [first, spot] : [spot];
    this.draw();
    if (!first) {
      part("answer").textContent = this.words.secondPlace;
      return;
    }
    const eye = eyeAt(first, this.about);
    const sight = await this.pool.run("sightline", { eye, spot, state: click.state }, true);
    if (this.#spots[1] !== spot) return;
    const lengths = measured(first, spot, this.about);
    const height = eye.height * this.about.metres;
    part("answer").textContent = measureSentence(lengths, height, sight, this.words, this.nameOf);
    part("answer").dataset.measured = JSON.stringify({ ...lengths, ...sight, eye, spot });
  }

  /** Mark the places in the picture. */
  draw() {
    const { clientWidth: width, clientHeight: height } = part("picture");
    const places = this.#spots.map(({ point }) => this.camera.place(point, width, height));
    const [line, ...circles] = part("measure").children;
    for (const [k, circle] of circles.entries()) move(circle, "c", "", places[k]);
    for (const k of [0, 1]) move(line, "", String(k + 1), places[0] && places[1] && places[k]);
  }
}

/**
 * @param {SVGElement} shape is hidden without a place
 * @param {string} before the axis in the name of an attribute
 * @param {string} after
 * @param {number[] | null | undefined} place
 */
function move(shape, before, after, place) {
  shape.style.display = place ? "" : "none";
  if (!place) return;
  shape.setAttribute(`${before}x${after}`, String(place[0]));
  shape.setAttribute(`${before}y${after}`, String(place[1]));
}
