// @ts-check
/** What a worker of the page computes: rows of pictures, answers at points, and the proof. Its scene has a memory of its own. */

import { loadKernels, Scene } from "../module/scene.mjs";
import { Frame } from "./frame.mjs";

const GOLDEN = Math.PI * (3 - Math.sqrt(5));
const SKY_DIRECTIONS = 4096;
/** @typedef {{origin: number[], direction: number[], suns: Float64Array, now: number[] | null}} Question */

export class Tracer {
  /** @type {Frame | null} */ #frame = null;

  /**
   * @param {Scene} scene
   * @param {any} look positions, indices, the up axis, and the columns of `Look`
   */
  constructor(scene, look) {
    this.scene = scene;
    this.look = look;
    this.positions = look.positions;
    this.indices = look.indices;
    this.up = look.up === "z" ? 2 : 1;
  }

  /**
   * @param {Uint8Array} wasm
   * @param {any} kernels the list of kernels
   * @param {any} look
   */
  static async create(wasm, kernels, look) {
    const module = await loadKernels({ wasm, list: kernels });
    const scene = await Scene.create(look.positions, look.indices, { kernels: module, threads: 1 });
    return new Tracer(scene, look);
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
   * Rows of a picture.
   * @param {import("./frame.mjs").Band} band
   */
  band(band) {
    this.#frame ??= new Frame(this.scene.geometry, this.look);
    return this.#frame.draw(band);
  }

  /**
   * The point that a ray meets; null without one.
   * @param {{origin: number[], direction: number[]}} ray
   */
  meet({ origin, direction }) {
    const t = this.scene.closestHit(origin, direction).t[0];
    return t < Infinity ? origin.map((o, k) => o + t * direction[k]) : null;
  }

  /**
   * What a point sees of the sun through the day, and of the sky; null if the ray meets nothing. The states of the suns are
   * 0 behind the surface, 1 seen, 2 blocked.
   * @param {Question} question
   */
  ask({ origin, direction, suns, now }) {
    const hit = this.scene.closestHit(Float32Array.from(origin), Float32Array.from(direction));
    const face = hit.face[0];
    if (face < 0) return null;
    const flat = this.normal(face);
    const side = flat.reduce((sum, n, k) => sum + n * direction[k], 0) > 0 ? -1 : 1;
    const normal = flat.map((n) => side * n);
    const point = origin.map((o, k) => o + hit.t[0] * direction[k]);
    const start = receiver(point, normal);
    const states = this.#states(start, normal, face, suns);
    const at = now ? this.#states(start, normal, face, Float64Array.from(now)) : null;
    const sky = this.#sky(start, normal, face);
    return { face, point, normal, ...states, now: at?.states[0], nowBlocker: at?.blockers[0], sky };
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

const SHIFT = 2 ** -21; // of receivers off their surfaces, as in antumbra.query.receivers

/**
 * A point on a face, moved off it as far as float32 needs.
 * @param {number[]} point
 * @param {number[]} normal
 */
function receiver([x, y, z], normal) {
  const shift = SHIFT * Math.max(Math.abs(x), Math.abs(y), Math.abs(z));
  return [Math.fround(x + shift * normal[0]), Math.fround(y + shift * normal[1]), Math.fround(z + shift * normal[2])];
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
