// @ts-check
/** The picture: coarse as soon as anything changes, then finer, sample by sample, as the workers return rows. */

import { skyLight } from "./shadow_rays.mjs";

/** @typedef {import("./orbit.mjs").Orbit} Orbit */
/** @typedef {import("./pool.mjs").Pool} Pool */

export const SAMPLES = 64; // a pixel, of the finished picture
const MOST_PIXELS = 1_000_000;
const COARSE = 12_000; // pixels of the first picture after a change, for each worker
const BAND = 12_000; // pixels of a job
const [BRIGHT, SHOULDER, BACKDROP] = [0.75, 0.6, 0.75]; // of antumbra.picture.image_files and sky_background

/** What is shown: the sun's direction, or null at night; the tangent of half its angle; the share of daylight; paint. */
/** @typedef {{sun: number[] | null, radius: number, daylight: number, painted: boolean}} Light */

export class Picture {
  #change = 0;
  /** @type {(() => void) | null} */ #wake = null;
  #skyKey = "";
  #sky = new Float32Array();

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Pool} pool
   * @param {Orbit} camera
   * @param {() => Light} light
   * @param {(samples: number) => void} shown
   * @param {{state?: number, meter?: {exposure: number}}} options the state of the scene, counted from the last, which is
   *   -1; and the exposure, which pictures that are compared share
   */
  constructor(canvas, pool, camera, light, shown, { state = -1, meter = { exposure: 0 } } = {}) {
    this.canvas = canvas;
    this.pool = pool;
    this.camera = camera;
    this.light = light;
    this.shown = shown;
    this.state = state;
    this.meter = meter;
    this.samples = 0;
    this.up = camera.up === "z" ? 2 : 1;
    this.most = SAMPLES;
  }

  /**
   * Draw one sample only, since something hides the surfaces; or go on.
   * @param {boolean} hidden
   */
  pause(hidden) {
    if (hidden === this.most < SAMPLES) return;
    this.most = hidden ? 1 : SAMPLES;
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
    this.pool.drop("band");
    this.#wake?.();
  }

  /** @param {number} change */
  async #draw(change) {
    const [width, height] = this.#size();
    const coarse = Math.max(1, Math.sqrt((width * height) / (COARSE * this.pool.size)));
    this.samples = 0;
    if (coarse > 1.5) {
      const [w, h] = [Math.ceil(width / coarse), Math.ceil(height / coarse)];
      const light = await this.#pass(w, h, 0, change);
      if (!light) return;
      this.#show(light, w, h, 1);
      this.shown(0);
      await new Promise((done) => setTimeout(done, 0)); // for input
    }
    const sum = new Float32Array(4 * width * height);
    for (let sample = 0; sample < this.most; sample++) {
      if (change !== this.#change) return;
      const light = await this.#pass(width, height, sample, change);
      if (!light) return;
      for (let i = 0; i < sum.length; i++) sum[i] += light[i];
      this.samples = sample + 1;
      this.#show(sum, width, height, this.samples);
      this.shown(this.samples);
    }
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
   * One sample of each pixel; null if something has changed since.
   * @param {number} width
   * @param {number} height
   * @param {number} sample
   * @param {number} change
   */
  async #pass(width, height, sample, change) {
    const out = new Float32Array(4 * width * height);
    const rays = this.camera.rays(width, height);
    const rows = Math.max(1, Math.floor(BAND / width));
    const shown = this.light();
    const bands = Array.from({ length: Math.ceil(height / rows) }, (_, k) => k * rows).map(async (first) => {
      const job = { rays, width, first, rows: Math.min(rows, height - first), sample, ...shown, state: this.state };
      const light = await this.pool.run("band", job);
      if (light) out.set(light, 4 * width * first);
    });
    await Promise.all(bands);
    return change === this.#change ? out : null;
  }

  /**
   * The radiance of the sky behind each pixel, kept until the view changes.
   * @param {number} width
   * @param {number} height
   */
  #skyBehind(width, height) {
    const { corner, dx, dy } = this.camera.rays(width, height);
    const key = JSON.stringify([corner, dx, dy, width, height]);
    if (key === this.#skyKey) return this.#sky;
    this.#skyKey = key;
    this.#sky = new Float32Array(3 * width * height);
    for (let i = 0; i < width * height; i++) {
      const [x, y] = [(i % width) + 0.5, Math.floor(i / width) + 0.5];
      const [a, b, c] = [0, 1, 2].map((k) => corner[k] + x * dx[k] + y * dy[k]);
      this.#sky.set(skyLight((this.up === 2 ? c : b) / Math.hypot(a, b, c)), 3 * i);
    }
    return this.#sky;
  }

  /**
   * @param {Float32Array} sum
   * @param {number} width
   * @param {number} height
   * @param {number} samples
   */
  #show(sum, width, height, samples) {
    const { painted } = this.light();
    if (!painted) this.meter.exposure ||= exposureOf(sum) ?? 0;
    const image = new ImageData(width, height);
    const { data } = image;
    const dim = BACKDROP * (0.1 + 0.9 * this.light().daylight);
    const behind = this.#skyBehind(width, height);
    for (let i = 0; i < width * height; i++) {
      const share = sum[4 * i + 3] / samples;
      const factor = share > 0 ? (painted ? 1 : this.meter.exposure) / (samples * share) : 0;
      for (let c = 0; c < 3; c++) {
        const light = sum[4 * i + c] * factor;
        const surface = share * (painted ? light : rollOff(light));
        data[4 * i + c] = toByte(surface + (1 - share) * behind[3 * i + c] * dim);
      }
      data[4 * i + 3] = 255;
    }
    const small = new OffscreenCanvas(width, height);
    /** @type {any} */ (small.getContext("2d")).putImageData(image, 0, 0);
    const [w, h] = this.#size();
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    context.imageSmoothingQuality = "high";
    context.drawImage(small, 0, 0, w, h);
  }
}

/**
 * The exposure that makes a picture bright but not clipped, as antumbra.picture.image_files has it; null without light.
 * @param {Float32Array} light of one sample
 */
function exposureOf(light) {
  /** @type {number[]} */
  const values = [];
  for (let i = 0; i < light.length; i += 4) {
    const luminance = 0.2126 * light[i] + 0.7152 * light[i + 1] + 0.0722 * light[i + 2];
    if (light[i + 3] > 0 && luminance > 0) values.push(luminance);
  }
  if (values.length === 0) return null;
  values.sort((a, b) => a - b);
  const [middle, wide, high] = [0.5, 0.85, 0.97].map((share) => values[Math.floor(share * (values.length - 1))]);
  const exposure = BRIGHT / high;
  return exposure * Math.max(1, Math.min(0.4 / (middle * exposure), 0.75 / (wide * exposure), 1.7));
}

/** @param {number} x linear light */
function rollOff(x) {
  return x <= SHOULDER ? x : 1 - (1 - SHOULDER) * Math.exp((SHOULDER - x) / (1 - SHOULDER));
}

const BYTES = Uint8Array.from({ length: 4097 }, (_, i) => {
  const x = i / 4096;
  return Math.round(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055));
});

/** @param {number} linear in [0, 1] */
function toByte(linear) {
  return BYTES[Math.round(4096 * Math.min(1, Math.max(0, linear)))];
}
