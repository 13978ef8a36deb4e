// @ts-check
/** The picture: coarse as soon as anything changes, then finer, pass by pass, as the workers return rows. */

import { AMBIENT, SAMPLES_A_PASS } from "./lamps.mjs";
import { backdrop, dimmed, exposureOf, toScreen } from "./tone.mjs";

/** @typedef {import("./orbit.mjs").Orbit} Orbit */
/** @typedef {import("./pool.mjs").Pool} Pool */

export const SAMPLES = 64; // of a light for each pixel, of the finished picture
const MOST_PIXELS = 1_000_000;
const LEAST = 6000; // pixels of the picture that finds the ambient light and the speed
const COARSE = 12_000; // pixels of the first picture after a change, at least, as wider frusta save hardly any time;
const SLOW = 300; // and as many for each worker, if they can be drawn in so many milliseconds,
const PROMPT = 80; // or what can be drawn in so many, if that is more
const STEP = 4; // times as many pixels has the next picture, or more,
const SOON = 1000; // if these can be drawn in so many milliseconds
const FORGET = 0.8; // share of the speed that counts after a slower picture, as another task may have slowed it down
const BAND = 32_000; // pixels of a job, about
const TILE = 4; // rows of a job are a multiple of it, since kernels take pixels by 4 x 4

/** What is shown: the sun's direction, or null without it; the share of daylight; whether surfaces show numbers. */
/** @typedef {{sun: number[] | null, daylight: number, painted: boolean}} Light */

export class Picture {
  #change = 0;
  #speed = 0; // pixels a millisecond, of coarse pictures
  #coarse = false; // whether the coarse picture is being drawn, which changes do not stop: else a drag would show nothing
  /** @type {(() => void) | null} */ #wake = null;
  /** @type {number[] | null} */ #ambient = null;
  #behindKey = "";
  #behind = new Float32Array();

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Pool} pool
   * @param {Orbit} camera
   * @param {() => Light} light
   * @param {(samples: number) => void} shown
   * @param {{sky: {daylight: number} | null, state: number, meter: {exposure: number}, moving: () => boolean}} options
   *   the sky, if it is one of the lights, and its radiance if it is a soft daylight; the state of the scene, the last
   *   one being -1; the exposure of all pictures, which that of the last state sets; and whether the next change comes
   *   at once, so that finer pictures would not be seen
   */
  constructor(canvas, pool, camera, light, shown, { sky, state, meter, moving }) {
    this.canvas = canvas;
    this.pool = pool;
    this.camera = camera;
    this.light = light;
    this.shown = shown;
    this.sky = sky;
    this.state = state;
    this.meter = meter;
    this.moving = moving;
    this.samples = 0;
    this.most = SAMPLES;
  }

  /**
   * Draw one pass only, since something hides the surfaces; or go on.
   * @param {boolean} hidden
   */
  pause(hidden) {
    if (hidden === this.most < SAMPLES) return;
    this.most = hidden ? SAMPLES_A_PASS : SAMPLES;
    this.changed();
  }

  /** Draw anew, for ever. */
  async run() {
    for (;;) {
      const change = this.#change;
      await this.#draw(change);
      if (change === this.#change)
        await new Promise((done) => {
          this.#wake = () => done(null);
        });
    }
  }

  /** The camera, the light or the size has changed. */
  changed() {
    this.#change++;
    if (!this.#coarse) this.pool.drop("band", this.state);
    this.#wake?.();
  }

  /** @param {number} change */
  async #draw(change) {
    const [width, height] = this.#size();
    this.samples = 0;
    this.#coarse = true;
    if (!this.#ambient) await this.#timed(LEAST, null); // finds the ambient light and the speed
    const prompt = Math.min(COARSE * this.pool.size, this.#speed * SLOW);
    let pixels = Math.max(COARSE, prompt, this.#speed * PROMPT);
    const first = await this.#timed(pixels, null);
    this.#coarse = false;
    if (!first) return;
    this.#measure(first.light);
    this.#show(first.light, first.width, first.height, 1);
    this.shown(0);
    if (this.moving()) return;
    await new Promise((done) => setTimeout(done, 0)); // for input
    for (;;) {
      pixels = Math.max(STEP * pixels, this.#speed * SOON);
      if (STEP * pixels > width * height) break; // the whole picture takes little longer
      const finer = change === this.#change && (await this.#timed(pixels, change));
      if (!finer) return;
      this.#show(finer.light, finer.width, finer.height, 1);
      this.shown(0);
    }
    const sum = new Float32Array(4 * width * height);
    for (let pass = 0; this.samples < this.most; pass++) {
      if (change !== this.#change) return;
      const light = await this.#pass(width, height, pass, change);
      if (!light) return;
      if (pass === 0) this.#measure(light);
      for (let i = 0; i < sum.length; i++) sum[i] += light[i];
      this.samples = (pass + 1) * SAMPLES_A_PASS;
      this.#show(sum, width, height, pass + 1);
      this.shown(this.samples);
    }
  }

  /**
   * A small picture of about so many pixels, whose time tells the speed; null as of `#pass`.
   * @param {number} pixels
   * @param {number | null} change
   */
  async #timed(pixels, change) {
    const [full, high] = this.#size();
    const shrunk = Math.max(1, Math.sqrt((full * high) / pixels));
    const [width, height] = [Math.ceil(full / shrunk), Math.ceil(high / shrunk)];
    const begin = performance.now();
    const light = await this.#pass(width, height, 0, change);
    const speed = (width * height) / Math.max(1, performance.now() - begin);
    if (light) this.#speed = Math.max(FORGET * this.#speed, speed);
    return light && { light, width, height };
  }

  /** @param {Float32Array} light of a pass */
  #measure(light) {
    if (this.state === -1 || !this.meter.exposure) this.meter.exposure = exposureOf(light);
  }

  #size() {
    const { clientWidth, clientHeight } = this.canvas;
    const sharp = Math.min(
      globalThis.devicePixelRatio || 1,
      Math.sqrt(MOST_PIXELS / Math.max(1, clientWidth * clientHeight)),
    );
    return [Math.max(1, Math.round(clientWidth * sharp)), Math.max(1, Math.round(clientHeight * sharp))];
  }

  /**
   * The light of each pixel in a pass; null if something has changed since.
   * @param {number} width
   * @param {number} height
   * @param {number} pass
   * @param {number | null} change null: changes do not matter
   */
  async #pass(width, height, pass, change) {
    const out = new Float32Array(4 * width * height);
    const rays = this.camera.rays(width, height);
    const most = Math.min(BAND, (width * height) / this.pool.size);
    const rows = TILE * Math.max(1, Math.ceil(most / width / TILE));
    const shared = {
      rays,
      width,
      height,
      pass,
      ambient: this.#ambient ?? [0, 0, 0],
      ...this.light(),
      state: this.state,
    };
    const bands = Array.from({ length: Math.ceil(height / rows) }, async (_, k) => {
      const first = k * rows;
      const part = await this.pool.run("band", { ...shared, first, rows: Math.min(rows, height - first) });
      if (part) out.set(part.light, 4 * width * first);
      return part;
    });
    const parts = await Promise.all(bands);
    if ((change !== null && change !== this.#change) || parts.includes(null)) return null;
    const surfaces = parts.reduce((sum, part) => sum + part.surfaces, 0);
    const arrived = [0, 1, 2].map((k) => parts.reduce((sum, part) => sum + part.arrived[k], 0));
    if (pass === 0) this.#ambient = arrived.map((each) => (AMBIENT * each) / Math.max(1, surfaces));
    return out;
  }

  /**
   * The backdrop behind each pixel, kept until the view changes.
   * @param {number} width
   * @param {number} height
   */
  #backdrop(width, height) {
    const rays = this.camera.rays(width, height);
    const key = JSON.stringify([rays.corner, rays.dx, rays.dy, width, height]);
    if (key !== this.#behindKey) this.#behind = backdrop(rays, width, height, this.camera.up === "z" ? 2 : 1);
    this.#behindKey = key;
    return this.#behind;
  }

  /**
   * @param {Float32Array} sum
   * @param {number} width
   * @param {number} height
   * @param {number} passes
   */
  #show(sum, width, height, passes) {
    const { daylight, painted } = this.light();
    const dim = 0.1 + 0.9 * daylight; // eyes adapt to dusk only in part
    const exposure = painted ? null : this.meter.exposure * dim;
    const shown = this.sky && !painted ? dimmed(this.meter.exposure, this.sky.daylight * daylight) : { dim: 1, sky: 0 };
    const behind = shown && this.#backdrop(width, height);
    const bytes = toScreen(sum, passes, exposure, behind, dim * (shown?.dim ?? 1), shown?.sky);
    const small = new OffscreenCanvas(width, height);
    /** @type {any} */ (small.getContext("2d")).putImageData(new ImageData(bytes, width, height), 0, 0);
    const [w, h] = this.#size();
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    context.imageSmoothingQuality = "high";
    context.drawImage(small, 0, 0, w, h);
  }
}
