// @ts-check
/** Base colours and shading normals of pixels, by the kernels of `antumbra.picture.pixel_appearance`. */

import { LINEAR } from "./textures.mjs";

/** @typedef {import("../module/memory.mjs").MemoryArray} MemoryArray */
/** @typedef {import("../module/shadows.mjs").Geometry} Geometry */
/** @typedef {import("./frame.mjs").Rays} Rays */
/** @typedef {import("./textures.mjs").Texture} Texture */

/**
 * What pixels show: `face` indexes `colour`; the normals are those for shading, which differ from the others if `soft`.
 * @typedef {{face: MemoryArray, colour: MemoryArray, normal: MemoryArray, bend: MemoryArray, soft: boolean}} Shown
 */

/**
 * The look of a scene, as columns of the page; without materials, textures, vertex colours or normals, they are missing.
 * @typedef {object} Look
 * @property {"y" | "z"} up axis
 * @property {number[]} origin of the coordinates, in the world
 * @property {import("./surface_values.mjs").Layer | null} layer numbers that surfaces can show
 * @property {Float32Array} positions of vertices
 * @property {Int32Array} indices three vertices of each face
 * @property {Float32Array} colours of faces, each once
 * @property {Int32Array} colourOf the colour of each face
 * @property {Int32Array} materialOf the material of each face; -1: it has a plain colour
 * @property {Float32Array} factors red, green and blue of each material
 * @property {Int32Array} textureOf the texture of each material, or -1
 * @property {Uint8Array} textured whether each face shows the texture of its material
 * @property {Float32Array} [uvs] texture coordinates, each once
 * @property {Int32Array} [uvOf] those of each corner
 * @property {Float32Array} [tones] linear red, green, blue and alpha of vertices, each once
 * @property {Int32Array} [toneOf] those of each corner
 * @property {Int16Array} [normals] of vertices, each once, of any length
 * @property {Int32Array} [normalOf] those of each corner
 * @property {Uint8Array} bends of each corner, in parts of 255 of `sharpest`
 * @property {number} sharpest
 * @property {Texture[]} textures
 * @property {import("./lamps.mjs").Lamp[]} lamps
 * @property {{map: Float32Array, shape: number[], axes: number[][], daylight: number} | null} sky
 */

/**
 * The look that a page describes.
 * @param {any} about
 * @param {Record<string, any>} arrays its columns
 * @param {Texture[]} textures
 * @returns {Look}
 */
export function lookOf({ up, origin, layer, look }, arrays, textures) {
  const lamps = look.lamps.map((/** @type {any} */ lamp) => {
    const [samples, values] = (lamp.columns ?? []).map((/** @type {string} */ name) => arrays[name]);
    return { ...lamp, samples, values };
  });
  return { ...arrays, ...look, up, origin, layer, textures, lamps, sky: look.sky && { ...look.sky, map: arrays.sky } };
}

const ROWS = 4; // that kernels take at a time

export class Appearance {
  /** @type {any[] | null} */ #colours = null; // the arguments of `FaceColours`, without textures and vertex colours: null
  /** @type {MemoryArray[] | null} */ #normals = null;

  /**
   * @param {Geometry} geometry
   * @param {Look} look
   */
  constructor(geometry, look) {
    this.geometry = geometry;
    const { kernels, triangles, faces } = geometry;
    const { arena } = kernels;
    const row = (/** @type {number} */ k) => (faces ? faces[k] : k);
    this.plain = arena.array("f4", [triangles.shape[0], 3]);
    const plain = this.plain.view;
    for (let k = 0; k < triangles.shape[0]; k++) copy(look.colours, 3 * look.colourOf[row(k)], plain, 3 * k, 3);
    if (look.materialOf && (look.uvs || look.tones)) this.#colours = this.#faceColours(look);
    if (look.normals && look.normalOf) this.#normals = this.#cornerNormals(look, look.normals, look.normalOf);
  }

  /** @param {Look} look */
  #faceColours(look) {
    const { arena } = this.geometry.kernels;
    const n = look.materialOf.length;
    const materials = look.textureOf.length;
    const corners = (/** @type {any} */ values, /** @type {any} */ of, /** @type {number} */ size) => {
      const array = arena.array("f4", [values ? n : 0, 3, size]);
      const out = array.view;
      for (let corner = 0; corner < out.length / size; corner++)
        copy(values, size * of[corner], out, size * corner, size);
      return array;
    };
    const pixels = look.textures.map((/** @type {Texture} */ each) =>
      arena.array("u1", [each.pixels.length], each.pixels),
    );
    const mips = look.textures.map((/** @type {Texture} */ each) => arena.array("u1", [each.mips.length], each.mips));
    const address = (/** @type {MemoryArray[]} */ arrays) =>
      BigInt64Array.from(look.textureOf, (/** @type {number} */ k) => BigInt(k < 0 ? 0 : arrays[k].address));
    const of = (/** @type {(texture: Texture) => number[]} */ get) =>
      Array.from(look.textureOf, (/** @type {number} */ k) => (k < 0 ? [0, 0] : get(look.textures[k]))).flat();
    return [
      this.plain,
      arena.array("i4", [n], look.materialOf),
      arena.array("f4", [materials, 3], look.factors),
      arena.array(
        "b1",
        [materials],
        Array.from(look.textureOf, (/** @type {number} */ k) => Number(k >= 0)),
      ),
      arena.array("b1", [n], look.textured),
      corners(look.uvs, look.uvOf, 2),
      corners(look.tones, look.toneOf, 4),
      arena.array("i8", [materials], address(pixels)),
      arena.array("i8", [materials], address(mips)),
      arena.array(
        "i4",
        [materials, 2],
        of(({ width, height }) => [width, height]),
      ),
      arena.array(
        "i4",
        [materials, 2],
        of(({ wraps }) => wraps),
      ),
      arena.array(
        "b1",
        [materials],
        of(({ nearest }) => [Number(nearest), 0]).filter((_, k) => k % 2 === 0),
      ),
      arena.array("f4", [256], LINEAR),
    ];
  }

  /**
   * Normals of corners in the frames of their triangles (`antumbra.scene.appearance.normals_in_frames`), and their bends.
   * @param {Look} look
   * @param {Int16Array} given
   * @param {Int32Array} givenOf
   */
  #cornerNormals(look, given, givenOf) {
    const { arena } = this.geometry.kernels;
    const n = givenOf.length / 3;
    const made = [arena.array("f4", [n, 3, 3]), arena.array("f4", [n, 3])];
    const [normals, bends] = made.map(({ view }) => view);
    const { positions: p, indices } = look;
    const corner = [0, 0, 0];
    for (let face = 0; face < n; face++) {
      const [a, b, c] = [0, 1, 2].map((k) => 3 * indices[3 * face + k]);
      const u = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
      const v = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
      const g = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
      const scale = 1 / Math.sqrt(Math.hypot(g[0], g[1], g[2]) || 1);
      for (let k = 0; k < 3; k++) {
        const at = 3 * givenOf[3 * face + k];
        const length = Math.hypot(given[at], given[at + 1], given[at + 2]);
        for (let axis = 0; axis < 3; axis++) corner[axis] = length > 0 ? given[at + axis] / length : 0;
        const to = 9 * face + 3 * k;
        normals[to] = dot(corner, u);
        normals[to + 1] = dot(corner, v);
        normals[to + 2] = dot(corner, g) * scale;
        bends[3 * face + k] = (look.bends[3 * face + k] / 255) * look.sharpest;
      }
    }
    return made;
  }

  /**
   * What pixels show whose surfaces are white.
   * @param {any} surfaces
   * @returns {Shown}
   */
  white({ ids, normal, depth }) {
    const { arena } = this.geometry.kernels;
    const face = arena.array(
      "i4",
      ids.shape,
      ids.view.map((/** @type {number} */ id) => Math.min(id, 0)),
    );
    return { face, colour: arena.array("f4", [1, 3], [1, 1, 1]), normal, bend: depth, soft: false };
  }

  /**
   * What pixels show.
   * @param {any} surfaces
   * @param {Rays} rays
   * @returns {Shown}
   */
  at(surfaces, { origin, dy }) {
    const { kernels, triangles, origin: frame } = this.geometry;
    const { arena } = kernels;
    const { position, normal, depth, face, ids } = surfaces;
    const [rows, width] = ids.shape;
    const places = [position, normal, depth, face, ids, triangles];
    const shown = { face, colour: this.plain, normal, bend: depth, soft: false };
    if (this.#colours) {
      const albedo = arena.array("f4", [rows, width, 3]);
      const eye = [...origin.map((o, k) => o - frame[k]), Math.hypot(...dy), 0];
      kernels.run("antumbra.picture.pixel_appearance:_albedo_rows", rows, ROWS, places, this.#colours, eye, albedo);
      shown.colour = albedo.as("f4", [rows * width, 3]);
      shown.face = arena.array(
        "i4",
        [rows, width],
        ids.view.map((/** @type {number} */ id, /** @type {number} */ k) => (id < 0 ? -1 : k)),
      );
    }
    if (this.#normals) {
      const out = [arena.array("f4", [rows, width, 3]), arena.array("f4", [rows, width])];
      kernels.run("antumbra.picture.pixel_appearance:_normal_rows", rows, ROWS, places, ...this.#normals, out);
      Object.assign(shown, { normal: out[0], bend: out[1], soft: true });
    }
    return shown;
  }
}

/** @param {ArrayLike<number>} from @param {number} at @param {Float32Array} to @param {number} place @param {number} n */
function copy(from, at, to, place, n) {
  for (let k = 0; k < n; k++) to[place + k] = from[at + k];
}

/** @param {number[]} a @param {number[]} b */
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
