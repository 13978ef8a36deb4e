// @ts-check
/**
 * The sky of a place as a plot: what blocks it, and the paths of the sun on the day and at the solstices. Azimuths run
 * clockwise from true north at the top, and equal steps of elevation are equally far apart, as on the sheets of
 * `antumbra skyline`.
 */

import { sunAngles } from "../module/sun_position.mjs";
import { part } from "./parts.mjs";
import { BEHIND, BLOCKED } from "./questions.mjs";
import { clock, daysAfter, midnight } from "./sun.mjs";

/** @typedef {import("./sun.mjs").Place} Place */
/** @typedef {import("../module/sun_position.mjs").Angles} Angles */

const SIZE = 200; // directions across the plot
const MINUTES = 10; // between points of a path
const COLOURS = { blocked: [141, 147, 157], behind: [214, 217, 222], open: [238, 245, 252] };
const SOLSTICES = /** @type {const} */ ([
  ["06-21", "#d1495b"],
  ["12-21", "#2f6690"],
]); // of antumbra.city.sheets.sun_paths
const [TODAY, NOW, INK] = ["#c98a00", "#e03c31", "#3a4252"];
const HOURS = 3; // between numbers along the path

/** The plot of the place that was asked last. */
export class HorizonPlot {
  #point = "";
  /** @type {Uint8Array | null} */ #states = null;

  /**
   * @param {import("./pool.mjs").Pool} pool
   * @param {import("./sun_panel.mjs").SunPanel} sun
   * @param {import("./words.mjs").Words} words
   */
  constructor(pool, sun, words) {
    this.pool = pool;
    this.sun = sun;
    this.words = words;
    part("horizon").setAttribute("aria-label", words.horizon);
  }

  /**
   * @param {import("./questions.mjs").Spot | null} spot
   * @param {number} state of the scene
   */
  async show(spot, state) {
    part("horizon").hidden = !spot;
    const point = spot ? JSON.stringify([spot.point, spot.normal, state]) : "";
    if (point !== this.#point) {
      this.#point = point;
      const question = { spot, state, size: SIZE, north: this.sun.north };
      this.#states = spot && (await this.pool.run("horizon", question, true));
    }
    if (point !== this.#point || !this.#states) return;
    const { place, date } = this.sun;
    const angles = this.sun.shines ? this.sun.angles : null;
    drawHorizon(part("horizon"), this.#states, place && { place, date }, angles, this.words.compass.split(" "));
  }
}

/**
 * @param {HTMLCanvasElement} canvas
 * @param {Uint8Array} states of `horizon` of `questions.mjs`
 * @param {{place: Place, date: string} | null} when
 * @param {Angles | null} sun that is shown; null: none shines
 * @param {string[]} compass the letters of north, east, south and west
 */
function drawHorizon(canvas, states, when, sun, compass) {
  const sharp = globalThis.devicePixelRatio || 1;
  const side = canvas.clientWidth;
  Object.assign(canvas, { width: Math.round(side * sharp), height: Math.round(side * sharp) });
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.scale(sharp, sharp);
  const radius = side / 2 - 13;
  context.translate(side / 2, side / 2);
  context.drawImage(skyImage(states), -radius, -radius, 2 * radius, 2 * radius);
  const font = getComputedStyle(canvas).fontFamily;
  drawFrame(context, radius, compass, font);
  const at = (/** @type {Angles} */ { altitude, azimuth }) => {
    const [away, turn] = [radius * (1 - altitude / 90), (azimuth * Math.PI) / 180];
    return [away * Math.sin(turn), -away * Math.cos(turn)];
  };
  if (when) {
    const { place, date } = when;
    for (const [day, colour] of SOLSTICES) drawPath(context, place, `${date.slice(0, 4)}-${day}`, colour, 1.2, at);
    drawPath(context, place, date, TODAY, 2.4, at);
    drawHours(context, place, date, at, font);
  }
  if (sun && sun.altitude > 0) dot(context, at(sun), 4, NOW);
}

/** @param {Uint8Array} states */
function skyImage(states) {
  const image = new ImageData(SIZE, SIZE);
  for (let i = 0; i < states.length; i++) {
    const [right, down] = [i % SIZE, Math.floor(i / SIZE)].map((x) => (2 * (x + 0.5)) / SIZE - 1);
    if (Math.hypot(right, down) >= 1) continue;
    const name = states[i] === BLOCKED ? "blocked" : states[i] === BEHIND ? "behind" : "open";
    image.data.set([...COLOURS[name], 255], 4 * i);
  }
  const small = new OffscreenCanvas(SIZE, SIZE);
  /** @type {any} */ (small.getContext("2d")).putImageData(image, 0, 0);
  return small;
}

/**
 * The rim, circles at 30 and 60 degrees, and the compass.
 * @param {CanvasRenderingContext2D} context
 * @param {number} radius
 * @param {string[]} compass
 * @param {string} font
 */
function drawFrame(context, radius, compass, font) {
  Object.assign(context, { strokeStyle: "#0003", lineWidth: 1 });
  for (const share of [1, 2 / 3, 1 / 3]) {
    context.beginPath();
    context.arc(0, 0, share * radius, 0, 2 * Math.PI);
    context.stroke();
  }
  Object.assign(context, { fillStyle: INK, font: `11px ${font}`, textAlign: "center", textBaseline: "middle" });
  compass.forEach((letter, k) => {
    const turn = (k * Math.PI) / 2;
    context.fillText(letter, (radius + 7) * Math.sin(turn), -(radius + 7) * Math.cos(turn));
  });
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {Place} place
 * @param {string} date
 * @param {string} colour
 * @param {number} width
 * @param {(angles: Angles) => number[]} at
 */
function drawPath(context, place, date, colour, width, at) {
  Object.assign(context, { strokeStyle: colour, lineWidth: width });
  context.beginPath();
  const [first, last] = [midnight(place, date), midnight(place, daysAfter(date, 1))];
  for (let seconds = first, above = false; seconds <= last; seconds += 60 * MINUTES) {
    const angles = sunAngles(place, seconds);
    const [x, y] = at(angles);
    if (angles.altitude >= 0 && above) context.lineTo(x, y);
    else if (angles.altitude >= 0) context.moveTo(x, y);
    above = angles.altitude >= 0;
  }
  context.stroke();
}

/**
 * The full hours of the day, some with their numbers.
 * @param {CanvasRenderingContext2D} context
 * @param {Place} place
 * @param {string} date
 * @param {(angles: Angles) => number[]} at
 * @param {string} font
 */
function drawHours(context, place, date, at, font) {
  context.font = `10px ${font}`;
  const [first, last] = [midnight(place, date), midnight(place, daysAfter(date, 1))];
  for (let seconds = first; seconds < last; seconds += 3600) {
    const angles = sunAngles(place, seconds);
    if (angles.altitude <= 0) continue;
    const [x, y] = at(angles);
    dot(context, [x, y], 1.8, TODAY);
    const hour = Number(clock(place, seconds).slice(0, 2));
    context.fillStyle = INK;
    if (hour % HOURS === 0) context.fillText(String(hour), x, y + (y > 0 ? -8 : 9));
  }
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {number[]} at
 * @param {number} radius
 * @param {string} colour
 */
function dot(context, [x, y], radius, colour) {
  context.fillStyle = colour;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
}
