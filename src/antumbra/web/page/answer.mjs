// @ts-check
/** The answer at a point: a sentence, and the day as a bar. */

import { sunAngles } from "../module/sun_position.mjs";
import { BLOCKED, SEEN } from "./questions.mjs";
import { clock, dateAt, daysAfter, midnight, towards } from "./sun.mjs";
import { fill } from "./words.mjs";

/** @typedef {import("./sun.mjs").Place} Place */
/** @typedef {import("./words.mjs").Words} Words */

export const STEP = 5; // minutes of the intervals of a day, each judged at its middle, as by antumbra sun --step 5
const MOST_SPANS = 3; // in a sentence

/** @typedef {{starts: number[], ends: number[], directions: Float64Array, above: boolean[]}} Day */

/**
 * The intervals of a day, and the direction of the sun in the middle of each.
 * @param {Place} place
 * @param {string} date
 * @param {"y" | "z"} up
 * @param {number} step minutes
 * @returns {Day}
 */
export function dayOf(place, date, up, step = STEP) {
  const [first, last] = [midnight(place, date), midnight(place, daysAfter(date, 1))];
  const starts = Array.from({ length: Math.ceil((last - first) / 60 / step) }, (_, k) => first + 60 * step * k);
  const ends = starts.map((start) => Math.min(start + 60 * step, last));
  const angles = starts.map((start, k) => sunAngles(place, start + Math.floor((ends[k] - start) / 2)));
  const directions = Float64Array.from(angles.flatMap((each) => towards(each, place.north, up)));
  return { starts, ends, directions, above: angles.map(({ altitude }) => altitude > 0) };
}

/**
 * The suns above the horizon of days, in the order of time.
 * @param {Day[]} days
 * @returns {import("../module/sun.mjs").Suns}
 */
export function sunsAbove(days) {
  const rows = days.flatMap(({ starts, ends, directions, above }) =>
    starts
      .map((start, k) => ({
        hours: (ends[k] - start) / 3600,
        way: directions.subarray(3 * k, 3 * k + 3),
        up: above[k],
      }))
      .filter(({ up }) => up),
  );
  return {
    directions: Float64Array.from(rows.flatMap(({ way }) => [...way])),
    hours: Float64Array.from(rows, ({ hours }) => hours),
  };
}

/**
 * A day in words, such as 21 March.
 * @param {string} date
 * @param {Words} words
 */
export function dayName(date, words) {
  const form = new Intl.DateTimeFormat(words.locale, { day: "numeric", month: "long", timeZone: "UTC" });
  return form.format(Date.parse(`${date}T00:00:00Z`));
}

/**
 * Hours of sun.
 * @param {Day} day
 * @param {Uint8Array} states
 */
export function hoursOf({ starts, ends, above }, states) {
  return starts.reduce((sum, start, k) => sum + (above[k] && states[k] === SEEN ? ends[k] - start : 0), 0) / 3600;
}

/**
 * Runs of intervals in which the sun is blocked.
 * @param {Day} day
 * @param {Uint8Array} states
 * @param {Int32Array} blockers
 */
function spansOf({ starts, ends, above }, states, blockers) {
  /** @type {{from: number, to: number, faces: number[]}[]} */
  const spans = [];
  let open = false;
  starts.forEach((from, k) => {
    const blocked = above[k] && states[k] === BLOCKED;
    if (blocked && open) {
      const span = spans[spans.length - 1];
      span.to = ends[k];
      span.faces.push(blockers[k]);
    } else if (blocked) spans.push({ from, to: ends[k], faces: [blockers[k]] });
    open = blocked;
  });
  return spans;
}

/**
 * The text that occurs most often.
 * @param {string[]} names
 */
function commonest(names) {
  /** @type {Map<string, number>} */
  const counts = new Map();
  for (const name of names) counts.set(name, (counts.get(name) ?? 0) + 1);
  return [...counts].reduce((best, each) => (each[1] > best[1] ? each : best))[0];
}

/**
 * @param {number} hours
 */
export function duration(hours) {
  const minutes = Math.round(60 * hours);
  const parts = [];
  if (minutes >= 60) parts.push(`${Math.floor(minutes / 60)} h`);
  if (minutes % 60 > 0 || minutes === 0) parts.push(`${minutes % 60} min`);
  return parts.join(" ");
}

/**
 * What a worker found at a point, as a sentence.
 * @param {any} found
 * @param {{place: Place, date: string, day: Day} | null} when null: without a place, only the sun that is shown
 * @param {number | null} altitude of the sun that is shown, degrees; null: none shines
 * @param {Words} words
 * @param {(face: number) => string} nameOf an object, or ""
 */
export function sentenceOf(found, when, altitude, words, nameOf) {
  if (!found) return words.nothing;
  const share = Math.round(100 * found.sky);
  const now = nowOf(found, altitude, words, nameOf);
  if (!when) return `${now} ${fill(words.sky, { share })}`.trim();
  const { place, date, day } = when;
  const hours = hoursOf(day, found.states);
  const spans = spansText(spansOf(day, found.states, found.blockers), place, words, nameOf);
  const dayText =
    date === dateAt(place, Date.now() / 1000) ? words.today : fill(words.onDay, { date: dayName(date, words) });
  const sun = fill(hours > 0 ? words.sun : words.noSun, { hours: duration(hours), day: dayText });
  return `${now} ${fill(spans ? words.blockedSky : words.openSky, { sun, spans, share })}`;
}

/**
 * Whether a point is in the sun that is shown.
 * @param {any} found
 * @param {number | null} altitude of the sun, degrees; null: none shines
 * @param {Words} words
 * @param {(face: number) => string} nameOf an object, or ""
 */
export function nowOf({ now, nowBlocker }, altitude, words, nameOf) {
  if (altitude === null) return "";
  if (altitude <= 0) return words.atNight;
  if (now === SEEN) return words.inSun;
  if (now !== BLOCKED) return words.behind;
  const blocker = nameOf(nowBlocker);
  return blocker ? fill(words.inShadowOf, { blocker }) : words.inShadow;
}

/**
 * The longest runs in which the sun is blocked, in the order of time; "" if there are none.
 * @param {{from: number, to: number, faces: number[]}[]} all
 * @param {Place} place
 * @param {Words} words
 * @param {(face: number) => string} nameOf
 */
function spansText(all, place, words, nameOf) {
  const longest = [...all].sort((a, b) => b.to - b.from - (a.to - a.from)).slice(0, MOST_SPANS);
  const texts = all
    .filter((span) => longest.includes(span))
    .map(({ from, to, faces }) => {
      const blocker = commonest(faces.map(nameOf));
      const times = { from: clock(place, from), to: clock(place, to), blocker };
      return fill(blocker ? words.spanBy : words.span, times);
    });
  return new Intl.ListFormat(words.locale).format(texts);
}

/**
 * The day as a bar: light where the sun is seen, dark where it is blocked or behind the surface, empty at night.
 * @param {HTMLCanvasElement} canvas
 * @param {Day} day
 * @param {Uint8Array} states
 * @param {number} now seconds since 1970
 */
export function drawDay(canvas, { starts, ends, above }, states, now) {
  const width = Math.max(1, canvas.clientWidth * (globalThis.devicePixelRatio || 1));
  const height = Math.max(1, canvas.clientHeight * (globalThis.devicePixelRatio || 1));
  Object.assign(canvas, { width, height });
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const [first, last] = [starts[0], ends[ends.length - 1]];
  const x = (/** @type {number} */ seconds) => Math.round(((seconds - first) / (last - first)) * width);
  const colours = ["#8a93a3", "#f4b731", "#46506b"]; // behind, seen, blocked
  starts.forEach((start, k) => {
    context.fillStyle = above[k] ? colours[states[k]] : "#8883";
    context.fillRect(x(start), 0, x(ends[k]) - x(start), height);
  });
  const style = getComputedStyle(canvas);
  context.fillStyle = style.color;
  for (let hour = 6; hour < 24; hour += 6) context.fillRect(x(first + 3600 * hour), 0.75 * height, 1, height / 4);
  context.fillStyle = "#e03c31";
  context.fillRect(x(now) - 1, 0, 3, height);
}
