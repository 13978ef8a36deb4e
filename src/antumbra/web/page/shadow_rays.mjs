// @ts-check
/** Rays from surfaces to the sun and the sky: where they start, how they are spread over samples, and what light they carry. */

import { tangents } from "../module/vectors.mjs";

const SHIFT = 2 ** -21; // of receivers off their surfaces, as in antumbra.query.receivers
const [ZENITH, HORIZON, GROUND] = [
  [0.46, 0.63, 0.92],
  [0.92, 0.94, 0.97],
  [0.6, 0.59, 0.57],
]; // of antumbra.scene.sky

/** Rays from surfaces to lights, and the light that each carries to its pixel. */
export class ShadowRays {
  /** @param {number} most */
  constructor(most) {
    this.n = 0;
    this.starts = new Float32Array(3 * most);
    this.ways = new Float32Array(3 * most);
    this.skip = new Int32Array(most);
    this.light = new Float32Array(3 * most);
    this.pixels = new Int32Array(most);
    this.from = [0, 0, 0];
    this.face = -1;
    this.pixel = 0;
  }

  /**
   * The point from which the next rays start.
   * @param {number[]} point
   * @param {number[]} normal
   * @param {number} face
   * @param {number} pixel
   */
  start(point, normal, face, pixel) {
    this.from = receiver(point, normal);
    this.face = face;
    this.pixel = pixel;
  }

  /**
   * @param {number[]} way
   * @param {number[]} colour
   * @param {number} amount
   */
  add(way, colour, amount) {
    const ray = this.n++;
    for (let k = 0; k < 3; k++) {
      this.starts[3 * ray + k] = this.from[k];
      this.ways[3 * ray + k] = way[k];
      this.light[3 * ray + k] = colour[k] * amount;
    }
    this.skip[ray] = this.face;
    this.pixels[ray] = this.pixel;
  }

  /**
   * Add the light that arrives to pixels of four numbers.
   * @param {import("../module/scene.mjs").Scene} scene
   * @param {Float32Array} out
   */
  trace(scene, out) {
    const { n, starts, ways, skip } = this;
    const blocked = scene.occluded(starts.subarray(0, 3 * n), ways.subarray(0, 3 * n), {
      skipFace: skip.subarray(0, n),
    });
    for (let ray = 0; ray < n; ray++) {
      if (blocked[ray]) continue;
      const at = 4 * this.pixels[ray];
      for (let k = 0; k < 3; k++) out[at + k] += this.light[3 * ray + k];
    }
  }
}

/**
 * A point on a face, moved off it as far as float32 needs.
 * @param {number[]} point
 * @param {number[]} normal
 */
export function receiver([x, y, z], normal) {
  const shift = SHIFT * Math.max(Math.abs(x), Math.abs(y), Math.abs(z));
  return [Math.fround(x + shift * normal[0]), Math.fround(y + shift * normal[1]), Math.fround(z + shift * normal[2])];
}

/**
 * A direction about a normal, with a density in proportion to the cosine.
 * @param {number[]} normal
 * @param {number} share in [0, 1): the squared sine
 * @param {number} angle
 * @param {number[]} out
 */
export function cosineDirection(normal, share, angle, out) {
  const [u, v] = tangents(normal);
  const [height, a, b] = [Math.sqrt(1 - share), Math.sqrt(share) * Math.cos(angle), Math.sqrt(share) * Math.sin(angle)];
  for (let k = 0; k < 3; k++) out[k] = height * normal[k] + a * u[k] + b * v[k];
}

export const STEPS = [0.7548776662, 0.5698402909, 0.8566748838, 0.430159709]; // of additive sequences

/**
 * A number in [0, 1) of a pixel.
 * @param {number} pixel
 * @param {number} k
 */
export function hash(pixel, k) {
  let x = Math.imul(pixel + 1, 0x9e3779b1) ^ Math.imul(k + 1, 0x85ebca6b);
  x = Math.imul(x ^ (x >>> 15), 0x2c1b3c6d);
  x = Math.imul(x ^ (x >>> 12), 0x297a2d39);
  return ((x ^ (x >>> 15)) >>> 0) / 2 ** 32;
}

/**
 * @param {number} index
 * @param {number} base
 */
export function halton(index, base) {
  let [value, share] = [0, 1];
  for (let i = index; i > 0; i = Math.floor(i / base)) {
    share /= base;
    value += share * (i % base);
  }
  return value;
}

/**
 * The radiance of soft daylight.
 * @param {number} height sine of the elevation
 */
export function skyLight(height) {
  if (height >= 0) {
    const share = Math.min(height, 1) ** 0.6;
    return HORIZON.map((h, k) => h + (ZENITH[k] - h) * share);
  }
  const share = Math.min(-height / 0.35, 1);
  return HORIZON.map((h, k) => h + (GROUND[k] - h) * share * share * (3 - 2 * share));
}
