// @ts-check
/** Colours of numbers from 0 up, with the colours and ticks of `antumbra.picture.heat_maps`, and their bar. */

import { toWhole } from "../module/elementary.mjs";

const MOST_TICKS = 8;
const ROUNDING = 1e-9;

export class ColourScale {
  /**
   * @param {number[][]} palette sRGB, from 0 to the end of the scale
   * @param {number} most the greatest value
   */
  constructor(palette, most) {
    this.palette = palette;
    const power = 10 ** Math.floor(Math.log10(most / MOST_TICKS));
    const factor = /** @type {number} */ ([1, 2, 5, 10].find((k) => k * power * MOST_TICKS >= most));
    const count = Math.ceil(most / (factor * power) - ROUNDING);
    this.ticks = Array.from({ length: count + 1 }, (_, k) => Number((k * factor * power).toPrecision(6)));
    this.top = this.ticks[count];
  }

  /**
   * Three bytes.
   * @param {number} value
   */
  colour(value) {
    const at = Math.min(1, Math.max(0, value / this.top)) * (this.palette.length - 1);
    const k = Math.min(Math.floor(at), this.palette.length - 2);
    return this.palette[k].map((low, c) => toWhole(low * (1 - (at - k)) + this.palette[k + 1][c] * (at - k)));
  }

  /**
   * Draw the bar with its ticks.
   * @param {HTMLCanvasElement} canvas
   * @param {number} value that is marked; NaN: none
   */
  draw(canvas, value) {
    const sharp = globalThis.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    Object.assign(canvas, { width: Math.round(width * sharp), height: Math.round(height * sharp) });
    const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    context.scale(sharp, sharp);
    const [margin, bar] = [8, height - 16];
    const x = (/** @type {number} */ tick) => margin + (tick / this.top) * (width - 2 * margin);
    for (let column = 0; column < width - 2 * margin; column++) {
      context.fillStyle = `rgb(${this.colour(((column + 0.5) / (width - 2 * margin)) * this.top)})`;
      context.fillRect(margin + column, 0, 1.5, bar);
    }
    const style = getComputedStyle(canvas);
    Object.assign(context, { fillStyle: style.color, font: `11px ${style.fontFamily}`, textAlign: "center" });
    for (const tick of this.ticks) context.fillText(String(tick), x(tick), height - 3);
    if (Number.isNaN(value)) return;
    Object.assign(context, { strokeStyle: style.color, lineWidth: 2 });
    context.strokeRect(x(Math.min(value, this.top)) - 3, 1, 6, bar - 2);
  }
}
