// @ts-check
/** What a worker of the page computes: rows of pictures, answers at points, and the proof. Its scene has a memory of its own. */

import { loadKernels, Scene } from "../module/scene.mjs";
import { tangents } from "../module/vectors.mjs";
import { cosineDirection, halton, hash, receiver, ShadowRays, STEPS, skyLight } from "./shadow_rays.mjs";

const GOLDEN = Math.PI * (3 - Math.sqrt(5));
const SKY_DIRECTIONS = 4096;
const SUN_COLOUR = [1, 0.95, 0.87];
const SUN_INTENSITY = 4.5;
const AMBIENT = 0.12;

/**
 * Rays of a picture: pixel (x, y) looks from `origin` along `corner + x dx + y dy`.
 * @typedef {{origin: number[], corner: number[], dx: number[], dy: number[]}} Rays
 */

/**
 * Rows of a picture. The sun's direction is null while it is below the horizon; `radius` is the tangent of its half angle.
 * @typedef {{rays: Rays, width: number, first: number, rows: number, sample: number, sun: number[] | null,
 *   radius: number, daylight: number}} Band
 */

/** A place on a face, and the normal on the side that is asked about. */
/** @typedef {{face: number, point: number[], normal: number[]}} Spot */

/** `at`: the place to ask about instead of the one that the ray meets. */
/** @typedef {{origin: number[], direction: number[], suns: Float64Array, now: number[] | null, at?: Spot}} Question */

export class Tracer {
  /**
   * @param {Scene} scene
   * @param {Record<string, any>} arrays
   * @param {string} up
   */
  constructor(scene, arrays, up) {
    this.scene = scene;
    this.positions = arrays.positions;
    this.indices = arrays.indices;
    this.colours = arrays.colours;
    this.colourOf = arrays.colourOf;
    this.up = up === "z" ? 2 : 1;
  }

  /**
   * @param {Record<string, any>} arrays
   * @param {any} kernels the list of kernels
   * @param {string} up
   */
  static async create(arrays, kernels, up) {
    const module = await loadKernels({ wasm: arrays.wasm, list: kernels });
    const scene = await Scene.create(arrays.positions, arrays.indices, { kernels: module, threads: 1 });
    return new Tracer(scene, arrays, up);
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
  #shade({ width, first, sample, sun, radius, daylight }, { face, t }, origins, directions) {
    const n = face.length;
    const light = new Float32Array(4 * n);
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
      const base = ambient * (0.65 + 0.35 * normal[this.up]);
      for (let k = 0; k < 3; k++) light[4 * i + k] = base;
      light[4 * i + 3] = 1;
      shadows.start(point, normal, last, i);
      const cosine = sun ? normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2] : 0;
      if (sun && cosine > 0) {
        const r = sample > 0 ? radius * Math.sqrt(random[0]) : 0; // the first picture has hard shadows
        const [a, b] = [r * Math.cos(2 * Math.PI * random[1]), r * Math.sin(2 * Math.PI * random[1])];
        for (let k = 0; k < 3; k++) way[k] = sun[k] + a * u[k] + b * v[k];
        shadows.add(way, SUN_COLOUR, cosine * SUN_INTENSITY);
      }
      cosineDirection(normal, random[2], 2 * Math.PI * random[3], way);
      shadows.add(way, skyLight(way[this.up]), Math.PI * daylight);
    }
    shadows.trace(this.scene, light);
    for (let i = 0; i < n; i++)
      if (face[i] >= 0) for (let k = 0; k < 3; k++) light[4 * i + k] *= this.colours[3 * this.colourOf[face[i]] + k];
    return light;
  }

  /**
   * What a point sees of the sun through the day, and of the sky; null if the ray meets nothing. The states of the suns are
   * 0 behind the surface, 1 seen, 2 blocked.
   * @param {Question} question
   */
  ask({ origin, direction, suns, now, at: given }) {
    const spot = given ?? this.#spot(origin, direction);
    if (!spot) return null;
    const { face, point, normal } = spot;
    const start = receiver(point, normal);
    const states = this.#states(start, normal, face, suns);
    const at = now ? this.#states(start, normal, face, Float64Array.from(now)) : null;
    const sky = this.#sky(start, normal, face);
    return { face, point, normal, ...states, now: at?.states[0], nowBlocker: at?.blockers[0], sky };
  }

  /**
   * The place that a ray meets.
   * @param {number[]} origin
   * @param {number[]} direction
   * @returns {Spot | null}
   */
  #spot(origin, direction) {
    const hit = this.scene.closestHit(Float32Array.from(origin), Float32Array.from(direction));
    const face = hit.face[0];
    if (face < 0) return null;
    const flat = this.normal(face);
    const side = flat.reduce((sum, n, k) => sum + n * direction[k], 0) > 0 ? -1 : 1;
    return { face, point: origin.map((o, k) => o + hit.t[0] * direction[k]), normal: flat.map((n) => side * n) };
  }

  /**
   * @param {number[]} start
   * @param {number[]} normal
   * @param {number} face
   * @param {Float64Array} suns
   */
  #states(start, normal, face, suns) {
    const n = suns.length / 3;
    const states = new Uint8Array(n);
    const blockers = new Int32Array(n).fill(-1);
    const facing = Array.from({ length: n }, (_, i) => i).filter(
      (i) => normal[0] * suns[3 * i] + normal[1] * suns[3 * i + 1] + normal[2] * suns[3 * i + 2] > 0,
    );
    const ways = Float64Array.from(facing.flatMap((i) => [suns[3 * i], suns[3 * i + 1], suns[3 * i + 2]]));
    const options = { skipFace: new Int32Array(facing.length).fill(face) };
    const hits = this.scene.closestHit(repeat(start, facing.length), ways, options);
    facing.forEach((i, k) => {
      blockers[i] = hits.face[k];
      states[i] = hits.face[k] < 0 ? 1 : 2;
    });
    return { states, blockers };
  }

  /**
   * The share of the sky above the horizon that a point sees.
   * @param {number[]} start
   * @param {number[]} normal
   * @param {number} face
   */
  #sky(start, normal, face) {
    const ways = [];
    for (let i = 0; i < SKY_DIRECTIONS; i++) {
      const height = (i + 0.5) / SKY_DIRECTIONS;
      const level = Math.sqrt(1 - height * height);
      const [a, b] = [level * Math.cos(i * GOLDEN), level * Math.sin(i * GOLDEN)];
      const way = this.up === 2 ? [a, b, height] : [a, height, b];
      if (normal[0] * way[0] + normal[1] * way[1] + normal[2] * way[2] > 0) ways.push(...way);
    }
    const n = ways.length / 3;
    const blocked = this.scene.occluded(repeat(start, n), Float32Array.from(ways), {
      skipFace: new Int32Array(n).fill(face),
    });
    return blocked.reduce((open, each) => open + 1 - each, 0) / SKY_DIRECTIONS;
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

/**
 * @param {number[]} point
 * @param {number} n
 */
function repeat(point, n) {
  const out = new Float32Array(3 * n);
  for (let i = 0; i < n; i++) out.set(point, 3 * i);
  return out;
}
