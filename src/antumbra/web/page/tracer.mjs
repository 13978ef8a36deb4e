// @ts-check
/** What a worker of the page computes: rows of pictures, and the proof. Its scene has a memory of its own. */

import { loadKernels, Scene } from "../module/scene.mjs";
import { tangents } from "../module/vectors.mjs";
import { cosineDirection, halton, hash, ShadowRays, STEPS, skyLight } from "./shadow_rays.mjs";
import { SurfaceValues } from "./surface_values.mjs";

const SUN_COLOUR = [1, 0.95, 0.87];
const SUN_INTENSITY = 4.5;
const AMBIENT = 0.12;
const [PAINTED, PAINT_SUN, PAINT_SKY] = [0.45, 0.25, 0.3]; // light on painted surfaces, so that colours are those of the legend
const WHITE = [1, 1, 1];

/**
 * Rays of a picture: pixel (x, y) looks from `origin` along `corner + x dx + y dy`.
 * @typedef {{origin: number[], corner: number[], dx: number[], dy: number[]}} Rays
 */

/**
 * Rows of a picture. The sun's direction is null while it is below the horizon; `radius` is the tangent of its half angle;
 * `painted`: surfaces have the colours of their numbers.
 * @typedef {{rays: Rays, width: number, first: number, rows: number, sample: number, sun: number[] | null,
 *   radius: number, daylight: number, painted: boolean}} Band
 */

export class Tracer {
  /**
   * @param {Scene} scene
   * @param {Record<string, any>} arrays
   * @param {string} up
   * @param {number[]} origin of the coordinates, in the world
   */
  constructor(scene, arrays, up, origin) {
    this.scene = scene;
    this.positions = arrays.positions;
    this.indices = arrays.indices;
    this.colours = arrays.colours;
    this.colourOf = arrays.colourOf;
    this.up = up === "z" ? 2 : 1;
    this.values = arrays.layer ? new SurfaceValues(arrays.layer, arrays) : null;
    this.mesh = { positions: this.positions, indices: this.indices, origin, up: this.up };
  }

  /**
   * @param {Record<string, any>} arrays
   * @param {any} kernels the list of kernels
   * @param {string} up
   * @param {number[]} origin
   */
  static async create(arrays, kernels, up, origin) {
    const module = await loadKernels({ wasm: arrays.wasm, list: kernels });
    const scene = await Scene.create(arrays.positions, arrays.indices, { kernels: module, threads: 1 });
    return new Tracer(scene, arrays, up, origin);
  }

  /**
   * The unit normal of a face.
   * @param {number} face
   */
  normal(face) {
    const [a, b, c] = [0, 1, 2].map((k) => 3 * this.indices[3 * face + k]);
    const p = this.positions;
    const [ux, uy, uz] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
    const [vx, vy, vz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
    const n = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    const length = Math.hypot(...n) || 1;
    return n.map((each) => each / length);
  }

  /**
   * Rows of a picture: linear light and the share of surfaces, 4 numbers a pixel.
   * @param {Band} band
   */
  band(band) {
    const { rays, width, first, rows, sample } = band;
    const n = width * rows;
    const [jx, jy] = sample === 0 ? [0.5, 0.5] : [halton(sample, 2), halton(sample, 3)];
    const [origins, directions] = [new Float32Array(3 * n), new Float32Array(3 * n)];
    const { origin, corner, dx, dy } = rays;
    for (let i = 0; i < n; i++) {
      const [x, y] = [(i % width) + jx, first + Math.floor(i / width) + jy];
      for (let k = 0; k < 3; k++) {
        origins[3 * i + k] = origin[k];
        directions[3 * i + k] = corner[k] + x * dx[k] + y * dy[k];
      }
    }
    const hits = this.scene.closestHit(origins, directions);
    return this.#shade(band, hits, origins, directions);
  }

  /**
   * Light of the hit points: of the sun through a point of its disk, of the sky along one direction, and ambient.
   * @param {Band} band
   * @param {import("../module/scene.mjs").Hits} hits
   * @param {Float32Array} origins
   * @param {Float32Array} directions
   */
  #shade({ width, first, sample, sun, radius, daylight, painted }, { face, t }, origins, directions) {
    const n = face.length;
    const light = new Float32Array(4 * n);
    const values = painted ? this.values : null;
    const paint = new Float32Array(values ? 3 * n : 0);
    const shadows = new ShadowRays(2 * n);
    const [u, v] = sun ? tangents(sun) : [[], []];
    const [point, normal, random, way] = [
      [0, 0, 0],
      [0, 0, 0],
      [0, 0, 0, 0],
      [0, 0, 0],
    ];
    const ambient = AMBIENT * daylight * (sun ? 5 : 2.5);
    let last = -1;
    let flat = [0, 0, 0];
    for (let i = 0; i < n; i++) {
      if (face[i] < 0) continue;
      if (face[i] !== last) flat = this.normal(face[i]);
      last = face[i];
      const at = 3 * i;
      const along = flat[0] * directions[at] + flat[1] * directions[at + 1] + flat[2] * directions[at + 2];
      for (let k = 0; k < 3; k++) {
        normal[k] = along > 0 ? -flat[k] : flat[k];
        point[k] = origins[at + k] + t[i] * directions[at + k];
      }
      const pixel = (i % width) + (first + Math.floor(i / width)) * 4099;
      for (let k = 0; k < 4; k++) random[k] = (hash(pixel, k) + (sample + 1) * STEPS[k]) % 1;
      const base = values ? PAINTED : ambient * (0.65 + 0.35 * normal[this.up]);
      if (values) paint.set(values.colour(last, point, normal), 3 * i);
      for (let k = 0; k < 3; k++) light[4 * i + k] = base;
      light[4 * i + 3] = 1;
      shadows.start(point, normal, last, i);
      const cosine = sun ? normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2] : 0;
      if (sun && cosine > 0) {
        const r = sample > 0 ? radius * Math.sqrt(random[0]) : 0; // the first picture has hard shadows
        const [a, b] = [r * Math.cos(2 * Math.PI * random[1]), r * Math.sin(2 * Math.PI * random[1])];
        for (let k = 0; k < 3; k++) way[k] = sun[k] + a * u[k] + b * v[k];
        if (values) shadows.add(way, WHITE, PAINT_SUN);
        else shadows.add(way, SUN_COLOUR, cosine * SUN_INTENSITY);
      }
      cosineDirection(normal, random[2], 2 * Math.PI * random[3], way);
      if (values) shadows.add(way, WHITE, PAINT_SKY);
      else shadows.add(way, skyLight(way[this.up]), Math.PI * daylight);
    }
    shadows.trace(this.scene, light);
    for (let i = 0; i < n; i++)
      for (let k = 0; k < 3 && face[i] >= 0; k++)
        light[4 * i + k] *= values ? paint[3 * i + k] : this.colours[3 * this.colourOf[face[i]] + k];
    return light;
  }

  /**
   * The number of recorded rays whose answers have other bits here.
   * @param {Record<string, any>} recorded
   */
  prove({ origins, directions, blocked, faces, distances }) {
    const hits = this.scene.closestHit(origins, directions);
    const found = this.scene.occluded(origins, directions);
    let wrong = 0;
    for (let ray = 0; ray < faces.length; ray++)
      if (found[ray] !== blocked[ray] || hits.face[ray] !== faces[ray] || !Object.is(hits.t[ray], distances[ray]))
        wrong++;
    return wrong;
  }
}
