// @ts-check
/** Hours of sun on all faces: grids of sensors from coarse to fine, whose values come in from the workers. */

import { ColourScale } from "./colour_scale.mjs";
import { BACK, NOTHING } from "./questions.mjs";

/** @typedef {import("./overlay.mjs").Shown} Shown */
/** @typedef {import("./pool.mjs").Pool} Pool */
/** @typedef {import("./surface_grid.mjs").Level} Level */
/** @typedef {import("../module/sun.mjs").Suns} Suns */

const NO_VALUE = 70; // grey, as of antumbra.city.tables.false_colours
const DARKEST = 0.6; // factor on the colours of surfaces that are seen from the side
const SHADES = 1024; // of the scale

export class Painting {
  #run = 0;
  /** @type {Float64Array[]} of each level, by cell; NaN: not yet known */ #hours = [];
  /** @type {number[][]} */ #shades = [];

  /**
   * @param {Pool} pool
   * @param {Level[]} levels from coarse to fine
   * @param {number[][]} palette
   * @param {() => void} changed
   */
  constructor(pool, levels, palette, changed) {
    this.pool = pool;
    this.levels = levels;
    this.palette = palette;
    this.changed = changed;
    this.opaque = true;
    this.days = 1;
    this.state = /** @type {"painting" | "stopped" | "done"} */ ("stopped");
    this.level = 0;
    this.share = 0; // of the level
    this.scale = new ColourScale(palette, 1);
  }

  /** The finest grid that has values, and the one before, for what it has not yet. */
  get question() {
    const levels = this.levels.slice(Math.max(0, this.level - 1), this.level + 1);
    return { spacings: levels.map(({ spacing }) => spacing).reverse(), eye: null };
  }

  get spacing() {
    return this.levels[this.level].spacing;
  }

  /** The spacing of the last grid. */
  get finest() {
    return this.levels[this.levels.length - 1].spacing;
  }

  /**
   * Begin anew.
   * @param {Suns} suns of all days
   * @param {number} days over whose number hours are averaged
   * @param {() => void} finer is called when a finer grid begins
   */
  async start(suns, days, finer) {
    const run = ++this.#run;
    this.days = days;
    const most = suns.hours.reduce((sum, each) => sum + each, 0) / days;
    this.scale = new ColourScale(this.palette, Math.max(most, 1));
    this.#shades = Array.from({ length: SHADES + 1 }, (_, k) => this.scale.colour((k / SHADES) * this.scale.top));
    this.#hours = this.levels.map(() => new Float64Array());
    this.state = "painting";
    for (const [level, { spacing, cells, parts }] of this.levels.entries()) {
      this.#hours[level] = new Float64Array(cells).fill(Number.NaN);
      Object.assign(this, { level, share: 0 });
      finer();
      let [next, done] = [0, 0];
      const lanes = Array.from({ length: this.pool.size }, async () => {
        while (run === this.#run && next < parts.length) {
          const found = await this.pool.run("hours", { spacing, part: parts[next++], suns });
          if (run !== this.#run) return;
          this.#hours[level].set(found.values, found.start);
          this.share = ++done / parts.length;
          this.changed();
        }
      });
      await Promise.all(lanes);
      if (run !== this.#run) return;
    }
    this.state = "done";
    this.changed();
  }

  stop() {
    this.#run++;
    if (this.state === "painting") this.state = "stopped";
    this.changed();
  }

  /**
   * The hours of the sensor that a pixel shows, summed over the days; NaN: not yet known, or none.
   * @param {Shown} shown
   * @param {number} pixel
   */
  hours({ maps, spacings }, pixel) {
    for (let k = 0; k < maps.length; k++) {
      const level = this.levels.findIndex(({ spacing }) => spacing === spacings[k]);
      const value = maps[k][pixel] >= 0 ? this.#hours[level][maps[k][pixel]] : Number.NaN;
      if (value >= 0) return value;
    }
    return Number.NaN;
  }

  /**
   * @param {Shown} shown
   * @param {number} pixel
   * @param {Uint8ClampedArray} out
   */
  colour(shown, pixel, out) {
    const cell = shown.maps[0][pixel];
    if (cell === NOTHING) return;
    const value = cell === BACK ? Number.NaN : this.hours(shown, pixel) / this.days;
    const light = DARKEST + ((1 - DARKEST) * shown.facing[pixel]) / 255;
    const shade = this.#shades[Math.round((Math.min(value, this.scale.top) / this.scale.top) * SHADES)];
    for (let c = 0; c < 3; c++) out[4 * pixel + c] = light * (shade ? shade[c] : NO_VALUE);
    out[4 * pixel + 3] = 255;
  }
}
