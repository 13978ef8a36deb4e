// @ts-check
/** Which samples of a light points see: by shafts through the tree of blocks, or segment by segment. */

import { treeList } from "./blocks.mjs";
import { KINDS, patchOf } from "./lights.mjs";
import { blockedSegments, COUNTERS, MOST_RAYS } from "./rays.mjs";
import { SETS } from "./samples.mjs";

/** @typedef {import("./frame.mjs").Receivers} Receivers */
/** @typedef {import("./kernels.mjs").KernelInstance} KernelInstance */
/** @typedef {import("./lights.mjs").Patch} Patch */
/** @typedef {import("./memory.mjs").MemoryArray} MemoryArray */

/**
 * A scene in WebAssembly's memory; without trees if no triangle has an area. `faces`: those of the trees' triangles; null:
 * all.
 * @typedef {{kernels: KernelInstance, wide: any[] | null, blocks: import("./blocks.mjs").BlockTree | null,
 *   origin: number[], box: import("./frame.mjs").Box, triangles: MemoryArray, faces: Int32Array | null}} Geometry
 */

const STRATA = 16; // samples of a chunk
const LANES = 16; // points of a tile, tiles of a region
const RUN = 64; // regions
const MOST_REGIONS = 4; // that a thread takes at a time
const BUSY = 64; // least regions for each thread for which it takes several at a time
const MOST_POINTS = 1 << 18; // that are in memory at once
const TINY = 2 ** -126; // the least normal number of float32
const MOST_RATIO = 2 ** 120; // largest distance of points and lights, in widths of the scene
const FAR = 2 ** 40; // up to this coordinate, float32 holds what shafts multiply
const [HUGE, LARGE, FEW] = [0.5, 0.1, 8]; // shares of the scene from which light is too wide for shafts; few samples

/** Which samples of a light points see. */
export class Visibility {
  /** @param {number} n points @param {number} samples of the light for each of them */
  constructor(n, samples) {
    this.samples = samples;
    /** The share of the samples that each point sees, 0 to 1; NaN for a point that is not finite, or whose normal is not. */
    this.fraction = new Float32Array(n);
    /** The samples that are blocked, 64 bits a point, or a multiple of it: bit s % 32 of word s >> 5 is sample s. */
    this.bits = new Uint32Array(2 * n * Math.ceil(samples / 64));
  }

  /** 1 where a point sees a sample, 0 elsewhere: `samples` numbers a point. */
  get seenSamples() {
    const words = 2 * Math.ceil(this.samples / 64);
    const seen = new Uint8Array(this.fraction.length * this.samples);
    for (let i = 0, at = 0; i < this.fraction.length; i++)
      for (let s = 0; s < this.samples; s++) seen[at++] = 1 ^ ((this.bits[i * words + (s >> 5)] >>> (s & 31)) & 1);
    return seen;
  }
}

/**
 * @param {Geometry} geometry
 * @param {Receivers} receivers
 * @param {import("./lights.mjs").Light} light
 * @param {number} samples
 * @param {number} cull a value of CULL_FACES
 */
export function visibilityOf(geometry, receivers, light, samples, cull) {
  const { kernels, origin, box } = geometry;
  const n = receivers.sides.length;
  const reach = n ? reachOf(box, receivers.origins) : 1;
  const patch = patchOf(light, samples, origin, reach);
  checkRatio(box, patch, reach);
  const out = new Visibility(n, patch.n);
  const shafts = suitsShafts(geometry, patch, receivers.origins);
  const most = shafts ? MOST_POINTS : Math.max(SETS, Math.floor(MOST_RAYS / patch.traced / SETS) * SETS);
  for (let first = 0; first < n; first += most)
    kernels.arena.scratch(() => {
      const m = Math.min(most, n - first);
      const query = shadowQuery(geometry, receivers, first, m, patch, cull);
      const bits = kernels.arena.array("u8", [1, m, Math.ceil(patch.traced / 64)]);
      (shafts ? traceShafts : traceSegments)(geometry, query, patch, bits);
      const words = bits.as("i4", [2 * bits.length]).view;
      if (patch.traced === patch.n) out.bits.set(words, 2 * first * bits.shape[2]);
      else for (let i = 0; i < m; i++) if (words[2 * i] & 1) block(out, first + i);
    });
  for (const i of receivers.failed) block(out, i);
  countSeen(out);
  for (const i of receivers.failed) out.fraction[i] = NaN;
  return out;
}

/** Set the bits of all samples of a point. @param {Visibility} out @param {number} i */
function block(out, i) {
  const words = out.bits.length / out.fraction.length;
  for (let s = 0; s < out.samples; s++) out.bits[i * words + (s >> 5)] |= 1 << (s & 31);
}

/** Write the fractions. @param {Visibility} out */
function countSeen({ bits, fraction, samples }) {
  const words = bits.length / fraction.length;
  for (let i = 0; i < fraction.length; i++) {
    let blocked = 0;
    for (let k = 0; k < words; k++) for (let word = bits[i * words + k]; word !== 0; word &= word - 1) blocked++;
    fraction[i] = 1 - blocked / samples;
  }
}

/**
 * A length greater than the distance from any point to any corner.
 * @param {import("./frame.mjs").Box} box
 * @param {ArrayLike<number>} origins
 */
export function reachOf([lower, upper], origins) {
  let sum = 0;
  for (let axis = 0; axis < 3; axis++) {
    let [low, high] = [lower[axis], upper[axis]];
    for (let i = axis; i < origins.length; i += 3) {
      if (origins[i] < low) low = origins[i];
      if (origins[i] > high) high = origins[i];
    }
    sum += (high - low) * (high - low);
  }
  return 2 * Math.sqrt(sum) + TINY;
}

/** @param {import("./frame.mjs").Box} box @param {Patch} patch @param {number} reach */
function checkRatio([lower, upper], patch, reach) {
  const width = Math.max(...lower.map((low, axis) => upper[axis] - low));
  const far = Math.max(reach, largest(patch.axes.flat()) + patch.radius);
  if (width > 0 && far > MOST_RATIO * width)
    throw new RangeError(
      `points, or the light, are ${far.toPrecision(3)} units away from a scene that is ${width.toPrecision(3)} units ` +
        `wide; bring them nearer than ${MOST_RATIO.toPrecision(2)} times its width`,
    );
}

/** @param {ArrayLike<number>} values */
function largest(values) {
  let out = 0;
  for (let i = 0; i < values.length; i++) out = Math.max(out, Math.abs(values[i]));
  return out;
}

/**
 * Whether shafts trace a light: not the whole sky, no lamp as large as the scene, and no coordinates beyond their range.
 * @param {Geometry} geometry
 * @param {Patch} patch
 * @param {Float32Array} origins
 */
export function suitsShafts({ blocks, box }, patch, origins) {
  if (!blocks || patch.kind === KINDS.AMBIENT) return false;
  const [base, u, v, w] = patch.axes;
  const across = [...u, ...v, ...w].reduce((sum, x) => sum + Math.abs(x), 0) * Math.max(1, largest(patch.samples));
  const far = largest(box.flat()) + largest(base) + 3 * patch.radius + across + largest(origins);
  if (!(far <= FAR)) return false;
  if (patch.kind !== KINDS.FIXED) return true;
  const limit = patch.traced < FEW ? LARGE : HUGE;
  return chunkExtents(patch) <= limit * blocks.extents.reduce((sum, x) => sum + x, 0);
}

/** The mean of the extents of a chunk's samples, summed over the axes. @param {Patch} patch */
function chunkExtents({ axes: [, u, v, w], traced, samples }) {
  const chunks = Math.ceil(traced / STRATA);
  let sum = 0;
  for (let chunk = 0; chunk < chunks; chunk++)
    for (let axis = 0; axis < 3; axis++) {
      let [low, high] = [Infinity, -Infinity];
      for (let set = 0; set < SETS; set++)
        for (let s = chunk * STRATA; s < Math.min(traced, (chunk + 1) * STRATA); s++) {
          const at = 3 * (set * traced + s);
          const x = samples[at] * u[axis] + samples[at + 1] * v[axis] + samples[at + 2] * w[axis];
          [low, high] = [Math.min(low, x), Math.max(high, x)];
        }
      sum += high - low;
    }
  return sum / chunks;
}

/**
 * The arguments of a `ShadowQuery` for part of the receivers.
 * @param {Geometry} geometry
 * @param {Receivers} receivers
 * @param {number} first
 * @param {number} m
 * @param {Patch} patch
 * @param {number} cull
 */
function shadowQuery({ kernels: { arena }, blocks }, { origins, sides, normals }, first, m, patch, cull) {
  const of = (/** @type {any} */ values, /** @type {number} */ each) =>
    values.subarray(each * first, each * (first + m));
  const faces = arena.array("i4", [1, m]);
  faces.view.fill(-1);
  const axes = patch.axes.map((axis) => arena.array("f8", [3], axis));
  return [
    arena.array("f4", [1, m, 3], of(origins, 3)),
    faces,
    arena.array("i1", [1, m], of(sides, 1)),
    normals ? arena.array("f8", [1, m, 3], of(normals, 3)) : arena.array("f8", [0, 0, 3]),
    blocks?.corners ?? arena.array("f4", [0, 9]),
    [patch.kind, ...axes, patch.radius],
    arena.array("f8", [SETS, patch.traced, 3], patch.samples),
    cull,
    faces,
  ];
}

/**
 * Trace a query: by shafts if they suit it. The receivers are pixels, or points in a row.
 * @param {Geometry} geometry
 * @param {any[]} query the arguments of a `ShadowQuery`
 * @param {Patch} patch
 * @param {MemoryArray} bits (h, w, words)
 */
export function traceQuery(geometry, query, patch, bits) {
  (suitsShafts(geometry, patch, query[0].view) ? traceShafts : traceSegments)(geometry, query, patch, bits);
}

/**
 * Trace a query by shafts. Tiles are 16 points of a row, or 4 x 4 pixels.
 * @param {Geometry} geometry
 * @param {any[]} query
 * @param {Patch} patch
 * @param {MemoryArray} bits
 */
function traceShafts({ kernels, blocks }, query, patch, bits) {
  const { arena } = kernels;
  const trees = treeList(kernels, /** @type {any} */ (blocks));
  const [h, w] = bits.shape;
  const side = h === 1 ? [LANES, 1] : [4, 4]; // of tiles in pixels, and of regions in tiles
  const table = lightTable(kernels, query, patch, h === 1);
  const counters = arena.array("i8", [COUNTERS]);
  const tiles = [Math.ceil(w / side[0]), Math.ceil(h / side[1])];
  const [across, down] = [Math.ceil(tiles[0] / side[0]), Math.ceil(tiles[1] / side[1])];
  const regions = across * down >= BUSY * (kernels.helpers.workers.length + 1) ? MOST_REGIONS : 1;
  const runs = down === 1 ? Math.ceil(across / RUN) : Math.ceil(across / 8) * Math.ceil(down / 8);
  const places = [...side, ...tiles, ...side, across, down]; // `TileShape`, `RegionLayout`
  for (let chunk = 0; chunk * STRATA < patch.traced; chunk++) {
    const count = Math.min(STRATA, patch.traced - chunk * STRATA);
    const args = [trees, query, table, places, regions, chunk, count, bits, counters];
    kernels.run("antumbra.trace.frusta.multi_frusta:_trace_areas", (runs * RUN) / regions, 1, ...args);
  }
}

/**
 * The arrays of a `LightTable`.
 * @param {KernelInstance} kernels
 * @param {any[]} query
 * @param {Patch} patch
 * @param {boolean} row whether the receivers are in a row, so that four sets are used
 */
export function lightTable(kernels, query, patch, row) {
  const { arena } = kernels;
  const chunks = Math.ceil(patch.traced / STRATA);
  const [points, groups, targets, byLane] = [
    arena.array("f4", [chunks, STRATA, 3, LANES]),
    arena.array("f4", [chunks, 6, 32]),
    arena.array("f4", [chunks, 6, LANES]),
    arena.array("f4", [chunks, LANES, 3, STRATA]),
  ];
  const sets = Array.from({ length: LANES }, (_, lane) => (row ? lane & 3 : lane));
  if (patch.kind === KINDS.FIXED || patch.kind === KINDS.LIST) {
    const unused = arena.array("f8", [chunks, 1, 1, 1]);
    const table = [points, groups, targets, byLane, unused, unused];
    const args = [query[5], query[6], arena.array("i8", [LANES], sets.map(BigInt)), table];
    kernels.call("antumbra.trace.light_table:_fixed_table", ...args);
    return table;
  }
  const [strata, lanes] = [points, byLane].map(({ shape }) => arena.array("f8", shape));
  const [byStratum, own] = [strata.view, lanes.view];
  for (let s = 0; s < chunks * STRATA; s++)
    for (let lane = 0; lane < LANES; lane++)
      for (let axis = 0; axis < 3; axis++) {
        const value = patch.samples[3 * (sets[lane] * patch.traced + Math.min(s, patch.traced - 1)) + axis];
        byStratum[48 * s + 16 * axis + lane] = value;
        own[768 * (s >> 4) + 48 * lane + 16 * axis + (s & 15)] = value;
      }
  return [points, groups, targets, byLane, strata, lanes];
}

/**
 * Trace a query segment by segment.
 * @param {Geometry} geometry
 * @param {any[]} query
 * @param {Patch} patch
 * @param {MemoryArray} bits
 */
function traceSegments({ kernels, wide }, query, { traced }, bits) {
  const { arena } = kernels;
  const [h, w, words] = bits.shape;
  const [ends, above] = [arena.array("f4", [h, w, traced, 3]), arena.array("b1", [h, w, traced])];
  kernels.call("antumbra.query.shadow_query:_segments_kernel", query, ends, above);
  const open = [];
  const isAbove = above.view;
  for (let k = 0; k < isAbove.length; k++) if (isAbove[k]) open.push(k);
  const [starts, targets] = [arena.array("f4", [open.length, 3]), arena.array("f4", [open.length, 3])];
  const [from, to, points, samples] = [starts, targets, query[0], ends].map(({ view }) => view);
  open.forEach((k, at) => {
    const i = Math.floor(k / traced);
    for (let axis = 0; axis < 3; axis++) {
      from[3 * at + axis] = points[3 * i + axis];
      to[3 * at + axis] = samples[3 * k + axis];
    }
  });
  const blocked = isAbove.map((/** @type {number} */ bit) => 1 - bit);
  if (wide && open.length > 0) {
    const found = blockedSegments(kernels, wide, starts, targets, query[7]);
    open.forEach((k, at) => {
      blocked[k] = found[at];
    });
  }
  const out = bits.as("i4", [2 * bits.length]).view;
  for (let k = 0; k < blocked.length; k++) {
    const s = k % traced;
    if (blocked[k]) out[((k - s) / traced) * 2 * words + (s >> 5)] |= 1 << (s & 31);
  }
}
