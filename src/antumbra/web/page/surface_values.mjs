// @ts-check
/** The numbers of a result on the surfaces of the scene: of faces, of corners of faces, or of points near the surface. */

import { colourOf } from "./layer.mjs";

/**
 * Which number belongs where. `faces`: the row of each face, -1: none. `corners`: the rows of the corners of each face,
 * between which numbers are interpolated. `points`: rows stand for points, which colour the surface within `reach`.
 * @typedef {import("./layer.mjs").Scale & {at: "faces" | "corners" | "points", reach: number}} Layer
 */

const NO_VALUE = [0.062, 0.062, 0.062]; // linear: the grey of surfaces without a value in false-colour pictures
const [X, Y, Z] = [73856093, 19349663, 83492791]; // of the hash of a cell

export class SurfaceValues {
  /**
   * @param {Layer} layer
   * @param {Record<string, any>} arrays
   */
  constructor(layer, arrays) {
    this.layer = layer;
    this.values = arrays.values;
    this.rowOf = arrays.rowOf;
    this.positions = arrays.positions;
    this.indices = arrays.indices;
    this.points = arrays.points;
    this.normals = arrays.pointNormals;
    this.faceOf = arrays.pointFaces;
    this.away = layer.reach; // a point that faces the other way is this times 2 farther
    /** @type {Map<number, number[]>} */
    this.linear = new Map();
    if (layer.at === "points") this.#sort();
  }

  /** Sort the points into cells by the hash of their places. A cell is twice the reach wide, so 8 cells hold all in reach. */
  #sort() {
    const n = this.points.length / 3;
    this.mask = 2 ** Math.ceil(Math.log2(n + 1)) * 2 - 1;
    const of = new Int32Array(n);
    this.starts = new Int32Array(this.mask + 2);
    for (let i = 0; i < n; i++) {
      const [x, y, z] = [0, 1, 2].map((k) => Math.floor(this.points[3 * i + k] / (2 * this.layer.reach)));
      of[i] = this.#cell(x, y, z);
      this.starts[of[i] + 1]++;
    }
    for (let k = 0; k <= this.mask; k++) this.starts[k + 1] += this.starts[k];
    const next = this.starts.slice();
    this.order = new Int32Array(n);
    for (let i = 0; i < n; i++) this.order[next[of[i]]++] = i;
  }

  /**
   * @param {number} x
   * @param {number} y
   * @param {number} z
   */
  #cell(x, y, z) {
    return (Math.imul(x, X) ^ Math.imul(y, Y) ^ Math.imul(z, Z)) & /** @type {number} */ (this.mask);
  }

  /**
   * The value at a point of a surface; NaN: none.
   * @param {number} face
   * @param {number[]} point
   * @param {number[]} normal towards the viewer
   */
  at(face, point, normal) {
    if (this.layer.at === "faces") return this.#valueOf(this.rowOf[face]);
    if (this.layer.at === "corners") return this.#between(face, point);
    return this.#valueOf(this.#nearest(face, point, normal));
  }

  /**
   * The colour of a point of a surface, linear.
   * @param {number} face
   * @param {number[]} point
   * @param {number[]} normal
   */
  colour(face, point, normal) {
    const value = this.at(face, point, normal);
    if (Number.isNaN(value)) return NO_VALUE;
    const srgb = colourOf(this.layer, value);
    const key = (srgb[0] << 16) | (srgb[1] << 8) | srgb[2];
    let found = this.linear.get(key);
    if (!found) {
      found = srgb.map((byte) => toLinear(byte / 255));
      this.linear.set(key, found);
    }
    return found;
  }

  /** @param {number} row */
  #valueOf(row) {
    return row < 0 ? Number.NaN : this.values[row];
  }

  /**
   * @param {number} face
   * @param {number[]} point
   */
  #between(face, point) {
    const p = this.positions;
    const corner = (/** @type {number} */ k) => 3 * this.indices[3 * face + k];
    const [a, b, c] = [corner(0), corner(1), corner(2)];
    const minus = (/** @type {number} */ i) => [p[i] - p[a], p[i + 1] - p[a + 1], p[i + 2] - p[a + 2]];
    const [e, f, d] = [minus(b), minus(c), point.map((each, k) => each - p[a + k])];
    const dot = (/** @type {number[]} */ u, /** @type {number[]} */ v) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
    const [ee, ef, ff, de, df] = [dot(e, e), dot(e, f), dot(f, f), dot(d, e), dot(d, f)];
    const area = ee * ff - ef * ef || 1;
    const [u, v] = [(ff * de - ef * df) / area, (ee * df - ef * de) / area];
    const [r, s, t] = [0, 1, 2].map((k) => this.#valueOf(this.rowOf[3 * face + k]));
    return r + u * (s - r) + v * (t - r);
  }

  /**
   * The nearest point within reach that faces the same way, of the same face if there is one; -1: none.
   * @param {number} face
   * @param {number[]} point
   * @param {number[]} normal
   */
  #nearest(face, point, normal) {
    const { order, starts, points, normals, faceOf, layer, away } = this;
    const most = layer.reach * layer.reach;
    const width = 2 * layer.reach;
    const first = point.map((each) => Math.floor(each / width - 0.5));
    let [best, found] = [2 * most, -1];
    for (let cell = 0; cell < 8; cell++) {
      const at = this.#cell(first[0] + (cell & 1), first[1] + ((cell >> 1) & 1), first[2] + (cell >> 2));
      const from = /** @type {Int32Array} */ (starts);
      for (let k = from[at]; k < from[at + 1]; k++) {
        const i = /** @type {Int32Array} */ (order)[k];
        let square = 0;
        for (let c = 0; c < 3; c++) square += (point[c] - points[3 * i + c]) ** 2;
        if (normals) for (let c = 0; c < 3; c++) square += (away * (normal[c] - normals[3 * i + c])) ** 2;
        if (square > most) continue;
        if (faceOf && faceOf[i] !== face) square += most;
        if (square >= best) continue;
        best = square;
        found = i;
      }
    }
    return found;
  }
}

/** @param {number} srgb in [0, 1] */
function toLinear(srgb) {
  return srgb <= 0.04045 ? srgb / 12.92 : ((srgb + 0.055) / 1.055) ** 2.4;
}
