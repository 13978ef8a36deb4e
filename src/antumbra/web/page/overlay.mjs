// @ts-check
/** A layer over the picture: colours of the surfaces that its pixels show, coarse while the camera moves, then finer. */

import { NOTHING } from "./questions.mjs";

/** @typedef {import("./orbit.mjs").Orbit} Orbit */
/** @typedef {import("./pool.mjs").Pool} Pool */

const MOST_PIXELS = 1_000_000;
const COARSE = 12_000; // pixels of the first layer after a change, for each worker
const BAND = 12_000; // pixels of a job

/** What workers found for the pixels of a picture: `surfaces` of `questions.mjs`. */
/** @typedef {{width: number, height: number, spacings: number[], maps: Int32Array[], facing: Uint8Array}} Shown */

/**
 * A layer: what to ask of each pixel, and its colour. `opaque`: it hides the surfaces.
 * @typedef {object} Layer
 * @property {boolean} opaque
 * @property {{spacings: number[], eye: any}} question
 * @property {(shown: Shown, pixel: number, out: Uint8ClampedArray) => void} colour writes four bytes at 4 * pixel
 */

export class Overlay {
  #change = 0;
  #drawing = false;
  #coarse = true;
  /** @type {Layer | null} */ #layer = null;
  /** @type {Shown | null} */ #shown = null;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Pool} pool
   * @param {Orbit} camera
   * @param {(reason: Error) => void} failed
   */
  constructor(canvas, pool, camera, failed) {
    this.canvas = canvas;
    this.pool = pool;
    this.camera = camera;
    this.failed = failed;
  }

  get layer() {
    return this.#layer;
  }

  /** @param {Layer | null} layer */
  show(layer) {
    this.#layer = layer;
    this.canvas.hidden = !layer;
    this.#shown = null;
    this.canvas.getContext("2d")?.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.changed();
  }

  /**
   * The view or the layer's question has changed.
   * @param {boolean} [coarse] whether a coarse layer is to come first
   */
  changed(coarse = true) {
    this.#change++;
    this.#coarse = coarse || !this.#shown;
    this.pool.drop("surfaces");
    if (this.#layer && !this.#drawing) this.#run().catch(this.failed);
  }

  /** The layer's colours have changed. */
  repaint() {
    const [layer, shown] = [this.#layer, this.#shown];
    if (!layer || !shown) return;
    const { width, height } = shown;
    const image = new ImageData(width, height);
    for (let i = 0; i < width * height; i++) if (shown.maps[0][i] !== NOTHING) layer.colour(shown, i, image.data);
    const small = new OffscreenCanvas(width, height);
    /** @type {any} */ (small.getContext("2d")).putImageData(image, 0, 0);
    const [w, h] = this.#size();
    if (this.canvas.width !== w || this.canvas.height !== h) Object.assign(this.canvas, { width: w, height: h });
    const context = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    context.clearRect(0, 0, w, h);
    context.imageSmoothingEnabled = false; // no colours of values that are nowhere
    context.drawImage(small, 0, 0, w, h);
  }

  /**
   * What is shown at a place of the picture: the pixel, or null.
   * @param {number} x in pixels of the page
   * @param {number} y
   * @returns {{shown: Shown, pixel: number} | null}
   */
  at(x, y) {
    const shown = this.#shown;
    if (!shown) return null;
    const column = Math.floor((x / this.canvas.clientWidth) * shown.width);
    const row = Math.floor((y / this.canvas.clientHeight) * shown.height);
    if (column < 0 || row < 0 || column >= shown.width || row >= shown.height) return null;
    return { shown, pixel: row * shown.width + column };
  }

  async #run() {
    this.#drawing = true;
    try {
      for (let change = -1; change !== this.#change && this.#layer; ) {
        change = this.#change;
        const [width, height] = this.#size();
        const coarse = Math.max(1, Math.sqrt((width * height) / (COARSE * this.pool.size)));
        if (this.#coarse && coarse > 1.5)
          await this.#draw(Math.ceil(width / coarse), Math.ceil(height / coarse), change);
        await new Promise((done) => setTimeout(done, 0)); // for input
        if (change === this.#change) await this.#draw(width, height, change);
      }
    } finally {
      this.#drawing = false;
    }
  }

  /**
   * @param {number} width
   * @param {number} height
   * @param {number} change
   */
  async #draw(width, height, change) {
    const layer = /** @type {Layer} */ (this.#layer);
    const rays = this.camera.rays(width, height);
    const rows = Math.max(1, Math.floor(BAND / width));
    const { spacings, eye } = layer.question;
    const maps = Array.from({ length: spacings.length + (eye ? 1 : 0) }, () => new Int32Array(width * height));
    const facing = new Uint8Array(width * height);
    const jobs = Array.from({ length: Math.ceil(height / rows) }, async (_, k) => {
      const first = k * rows;
      const job = { rays, width, first, rows: Math.min(rows, height - first), spacings, eye };
      const found = await this.pool.run("surfaces", job);
      if (!found) return;
      facing.set(found.facing, first * width);
      for (const [m, map] of found.maps.entries()) maps[m].set(map, first * width);
    });
    await Promise.all(jobs);
    if (change !== this.#change) return;
    this.#shown = { width, height, spacings, maps, facing };
    this.repaint();
  }

  /** Pixels of the device, but not too many. */
  #size() {
    const { clientWidth, clientHeight } = this.canvas;
    const most = Math.sqrt(MOST_PIXELS / Math.max(1, clientWidth * clientHeight));
    const sharp = Math.min(globalThis.devicePixelRatio || 1, most);
    return [Math.max(1, Math.round(clientWidth * sharp)), Math.max(1, Math.round(clientHeight * sharp))];
  }
}
