// @ts-check
/** Rows of a picture, by the kernels of `antumbra.picture`: surfaces, shadows, textures, and light. */

import { traceRays } from "../module/rays.mjs";
import { reachOf, traceQuery } from "../module/shadows.mjs";
import { Appearance } from "./appearance.mjs";
import { traceBeams } from "./beams.mjs";
import { emitterOf, lampPatch, listedLights } from "./lamps.mjs";
import { paint } from "./paint.mjs";
import { linksOf, REACH, smooth } from "./smoothing.mjs";

/** @typedef {import("../module/memory.mjs").MemoryArray} MemoryArray */
/** @typedef {import("../module/shadows.mjs").Geometry} Geometry */
/** @typedef {import("./lamps.mjs").Lamp} Lamp */

/**
 * Rays of a picture: pixel (x, y) looks from `origin` along `corner + (x + 0.5) dx + (y + 0.5) dy`.
 * @typedef {{origin: number[], corner: number[], dx: number[], dy: number[]}} Rays
 */

/**
 * Rows of a picture, from a multiple of 4 on. The sun's direction is null while it is below the horizon.
 * @typedef {{rays: Rays, width: number, height: number, first: number, rows: number, pass: number,
 *   sun: number[] | null, daylight: number, painted: boolean, ambient: number[]}} Band
 */

/** Light and coverage, four numbers a pixel; the sum of the light that arrives without shadows, and of surfaces. */
/** @typedef {{light: Float32Array, arrived: number[], surfaces: number}} Part */

/** The pixels that are wanted, among those that are drawn. @typedef {{from: number, to: number}} Own */

const NOTHING = 0; // no receiver
const FLAT_ROW = 8; // more pixels than a row has are scratch memory of the kernel of lists
const PLANES = 13; // of scratch memory for a row
const BLOCK = 256; // pixels that kernels take at a time
const TILE = 4; // rows of a tile

/** The places in a pixel that passes look through, from its centre, around which they lie evenly. */
const PLACES = [
  [0, 0],
  [-0.375, -0.125],
  [0.125, 0.375],
  [0.25, -0.25],
];

export class Frame {
  /**
   * @param {Geometry} geometry
   * @param {import("./appearance.mjs").Look} look
   * @param {import("./surface_values.mjs").SurfaceValues | null} values
   */
  constructor(geometry, look, values) {
    this.values = values;
    this.geometry = geometry;
    this.up = look.up === "z" ? 2 : 1;
    /** @type {Lamp[]} */
    this.lamps = look.lamps;
    this.sky = look.sky;
    const { arena } = geometry.kernels;
    this.map = look.sky ? arena.array("f4", look.sky.shape, look.sky.map) : null;
    this.appearance = new Appearance(geometry, look);
    this.reach = reachOf(geometry.box, []);
  }

  /**
   * @param {Band} band
   * @returns {Part}
   */
  draw(band) {
    const { kernels } = this.geometry;
    const { first, rows, height } = band;
    const smooths = this.lamps.some((lamp) => lamp.smooth);
    const above = smooths ? Math.min(first, TILE) : 0; // rows whose light is averaged too
    const below = smooths ? Math.min(height - first - rows, REACH) : 0;
    return kernels.arena.scratch(() => {
      const wide = { ...band, first: first - above, rows: above + rows + below };
      const rays = this.#rays(wide);
      const surfaces = this.#surfaces(wide, rays);
      const values = band.painted ? this.values : null;
      const shown = values ? this.appearance.white(surfaces) : this.appearance.at(surfaces, band.rays);
      const own = { from: above * band.width, to: (above + rows) * band.width };
      const light = this.#light(wide, surfaces, shown, own);
      if (values) paint(surfaces, values, this.geometry.origin, band.ambient, light.image);
      else if (this.sky) this.#addSky(wide, rays, surfaces, light.image);
      return pack(surfaces, light, own);
    });
  }

  /**
   * The arguments of `CameraRays`.
   * @param {Band} band
   */
  #rays({ rays: { origin, corner, dx, dy }, width, first, rows, pass }) {
    const { kernels, origin: frame } = this.geometry;
    const [x, y] = PLACES[pass % PLACES.length];
    const start = corner.map((c, k) => c + x * dx[k] + (first + y) * dy[k]);
    const vectors = [start, dx, dy].map((each) => kernels.arena.array("f8", [3], each));
    const eye = origin.map((o, k) => o - frame[k]);
    return [kernels.arena.array("f4", [3], eye), ...vectors, width, rows];
  }

  /**
   * The surfaces that pixels see: the arrays of a `GBuffer`, and the receivers at them.
   * @param {Band} band
   * @param {any[]} rays
   */
  #surfaces({ width, rows }, rays) {
    const { kernels, wide, triangles, faces } = this.geometry;
    const { arena } = kernels;
    const n = width * rows;
    const ways = arena.array("f4", [n, 3]);
    const [out, corner, dx, dy] = [ways, ...rays.slice(1, 4)].map(({ view }) => view);
    for (let at = 0, i = 0; i < n; i++) {
      const [x, y] = [(i % width) + 0.5, Math.floor(i / width) + 0.5];
      for (let k = 0; k < 3; k++) out[at++] = corner[k] + x * dx[k] + y * dy[k];
    }
    const list = [
      [rays[0].address, 0, 4, 0],
      [ways.address, 12, 4, 0],
      [0, 0, 0, 0],
      [0, 0, 0, Infinity],
      [0, 0, 0, -1],
    ];
    const hits = wide && traceRays(kernels, wide, [...list, [0, 0, 0], n, 0, false], n, false);
    const face = hits ? hits[1].as("i4", [rows, width]) : arena.array("i4", [rows, width], new Int32Array(n).fill(-1));
    const t = hits
      ? hits[2].as("f8", [rows, width])
      : arena.array("f8", [rows, width], new Float64Array(n).fill(Infinity));
    const buffer = {
      position: arena.array("f4", [rows, width, 3]),
      normal: arena.array("f4", [rows, width, 3]),
      face,
      depth: arena.array("f4", [rows, width]),
      side: arena.array("i1", [rows, width]),
      origin: arena.array("f8", [3]),
    };
    kernels.run("antumbra.query.gbuffer:_fill", rows, TILE, t, triangles, rays, 0, Object.values(buffer));
    const origins = arena.array("f4", [rows, width, 3]);
    const flat = [buffer.position.as("f4", [n, 3]), buffer.normal.as("f4", [n, 3]), face.as("i4", [n])];
    const receivers = [...flat, buffer.side.as("i1", [n]), triangles, origins.as("f4", [n, 3])];
    kernels.run("antumbra.query.receivers:_move_kernel", n, BLOCK, ...receivers);
    let ids = face;
    if (faces) {
      ids = arena.array("i4", [rows, width]);
      const [all, row] = [ids.view, face.view];
      for (let i = 0; i < n; i++) all[i] = row[i] < 0 ? -1 : faces[row[i]];
    }
    return { ...buffer, origins, ids };
  }

  /**
   * The light of all pixels.
   * @param {Band} band
   * @param {any} surfaces
   * @param {import("./appearance.mjs").Shown} shown
   * @param {Own} own
   */
  #light(band, surfaces, shown, own) {
    const { kernels } = this.geometry;
    const { arena } = kernels;
    const { width, rows, sun, pass, daylight } = band;
    const n = width * rows;
    const lit = this.lamps.filter((lamp) => !lamp.moves || sun);
    const single = lit.filter((lamp) => lamp.kind !== "list");
    const tints = arena.array(
      "f4",
      [single.length, 3],
      single.flatMap(({ tint }) => tint),
    );
    const irradiances = arena.array("f4", [single.length, rows, width]);
    const shares = arena.array("f4", [single.length, rows, width]);
    const lists = lit.filter((lamp) => lamp.kind === "list");
    const more = arena.array("f4", [lists.length, rows, width, 3]);
    const arrived = [0, 0, 0];
    const links = lists.some((lamp) => lamp.smooth) ? linksOf(kernels, surfaces, Math.hypot(...band.rays.dy)) : [];
    const normals = [shown.normal, surfaces.normal, shown.bend, shown.soft]; // `PixelNormals`
    const through = [arena.array("i4", [0, 0]), arena.array("f4", [0, 0, 1])];
    for (const lamp of lit) {
      const patch = lampPatch(lamp, sun, pass, this.geometry.origin, this.reach);
      arena.scratch(() => {
        const query = this.#query(surfaces, patch);
        const bits = arena.array("u8", [rows, width, Math.ceil(patch.traced / 64)]);
        const trace = lamp.kind === "list" ? traceBeams : traceQuery;
        trace(this.geometry, query, patch, bits);
        if (lamp.kind === "list") {
          const out = part(more, lists.indexOf(lamp));
          const listed = listedLights(arena, lamp, pass, lamp.daylight ? daylight : 1);
          const scratch = arena.array("f4", [PLANES * (width + FLAT_ROW)]);
          const buffer = GBUFFER.map((name) => surfaces[name]);
          const args = [buffer, normals, listed, bits, through, out, scratch];
          kernels.run("antumbra.picture.light_list_irradiance:_list_rows", rows, TILE, ...args);
          if (lamp.smooth) smooth(kernels, links, out);
          addTo(arrived, out.view.subarray(3 * own.from, 3 * own.to), [1, 1, 1], 3);
        } else {
          const k = single.indexOf(lamp);
          const [light, share] = [part(irradiances, k), part(shares, k)];
          const emitter = emitterOf(lamp, patch);
          const at = [surfaces.position, shown.normal, surfaces.side, emitter, light];
          kernels.run("antumbra.picture.irradiance:_irradiance_kernel", n, BLOCK, ...at);
          const table = sampleRows(arena, patch);
          const args = [query, table, bits, through, normals, share.as("f4", [rows, width, 1])];
          kernels.run("antumbra.picture.light_visibility:_share_kernel", n, BLOCK, ...args);
          addTo(arrived, light.view.subarray(own.from, own.to), lamp.tint, 1);
        }
      });
    }
    const image = arena.array("f4", [rows, width, 3]);
    const skies = arena.array("f4", [0, rows, width]);
    const ambient = arena.array("f4", [3], band.ambient);
    const pixels = [shown.face, shown.normal, this.up, shown.colour];
    const sums = arena.array("f4", [3 * width]);
    const arrays = [tints, irradiances, shares, skies, more, ambient];
    kernels.run("antumbra.picture.shading:_shade_rows", rows, TILE, pixels, arrays, image, sums);
    return { image, arrived };
  }

  /**
   * The arguments of a `ShadowQuery`.
   * @param {any} surfaces
   * @param {import("../module/lights.mjs").Patch} patch
   */
  #query({ origins, face, side }, { kind, axes, radius, traced, samples }) {
    const { kernels, triangles } = this.geometry;
    const { arena } = kernels;
    const light = [kind, ...axes.map((axis) => arena.array("f8", [3], axis)), radius];
    const sets = arena.array("f8", [16, traced, 3], samples);
    return [origins, face, side, arena.array("f8", [0, 0, 3]), triangles, light, sets, 0, face];
  }

  /**
   * Add the sky to the pixels without surfaces.
   * @param {Band} band
   * @param {any[]} rays
   * @param {any} surfaces
   * @param {MemoryArray} image
   */
  #addSky({ width, rows, daylight }, rays, { ids }, image) {
    const { kernels } = this.geometry;
    const mask = kernels.arena.array(
      "b1",
      [rows, width],
      ids.view.map((/** @type {number} */ id) => (id < 0 ? 1 : 0)),
    );
    const args = [rays, this.map, /** @type {any} */ (this.sky).axes, mask, image];
    kernels.run("antumbra.picture.sky_background:_sky_rows", rows, TILE, ...args);
    if (daylight === 1) return;
    const [out, free] = [image.view, mask.view];
    for (let i = 0; i < free.length; i++) if (free[i]) for (let k = 0; k < 3; k++) out[3 * i + k] *= daylight;
  }
}

const GBUFFER = ["position", "normal", "face", "depth", "side", "origin"];

/** One of an array of arrays. @param {MemoryArray} array @param {number} k */
function part(array, k) {
  const made = array.as(array.type, array.shape.slice(1));
  made.address += k * made.length * made.itemsize;
  return made;
}

/** The a and b of samples in rows of whole vectors. @param {any} arena @param {import("../module/lights.mjs").Patch} patch */
function sampleRows(arena, { traced, samples }) {
  const wide = Math.ceil(traced / 16) * 16;
  const rows = arena.array("f4", [16, 2, wide]);
  const out = rows.view;
  for (let set = 0; set < 16; set++)
    for (let s = 0; s < traced; s++)
      for (let k = 0; k < 2; k++) out[(2 * set + k) * wide + s] = samples[3 * (set * traced + s) + k];
  return rows;
}

/**
 * @param {number[]} sums of red, green and blue
 * @param {Float32Array} values
 * @param {number[]} tint
 * @param {number} step 3: each colour has its own values
 */
function addTo(sums, values, tint, step) {
  for (let k = 0; k < step; k++) {
    let sum = 0;
    for (let i = k; i < values.length; i += step) sum += values[i];
    if (step === 3) sums[k] += sum * tint[k];
    else for (let c = 0; c < 3; c++) sums[c] += sum * tint[c];
  }
}

/**
 * @param {any} surfaces
 * @param {{image: MemoryArray, arrived: number[]}} light
 * @param {Own} own
 * @returns {Part}
 */
function pack({ side }, { image, arrived }, { from, to }) {
  const [sides, colours] = [side.view, image.view];
  const light = new Float32Array(4 * (to - from));
  let surfaces = 0;
  for (let i = from, at = 0; i < to; i++, at += 4) {
    for (let k = 0; k < 3; k++) light[at + k] = colours[3 * i + k];
    if (sides[i] === NOTHING) continue;
    light[at + 3] = 1;
    surfaces++;
  }
  return { light, arrived, surfaces };
}
