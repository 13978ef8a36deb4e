// @ts-check
/** Rays through the eight-wide tree. */

/** @typedef {import("./kernels.mjs").KernelInstance} KernelInstance */
/** @typedef {import("./memory.mjs").MemoryArray} MemoryArray */

const BATCHES = 16; // of 64 rays, that a kernel takes at a time
const RAYS = 64;
export const COUNTERS = 15;
export const MOST_RAYS = 1 << 20; // rays that are in memory at once

/**
 * Trace rays in memory.
 * @param {KernelInstance} kernels
 * @param {any[]} tree a `WideBvh`
 * @param {any[]} list the arguments of a `RayList`
 * @param {number} n rays
 * @param {boolean} anyHit
 * @returns {MemoryArray[] | null} the arrays of `HitArrays`; null if a ray is invalid
 */
export function traceRays(kernels, tree, list, n, anyHit) {
  const { arena } = kernels;
  const m = anyHit ? 0 : n;
  const hits = [
    arena.array("b1", [anyHit ? n : 0]),
    arena.array("i4", [m]),
    arena.array("f8", [m]),
    arena.array("f4", [m]),
    arena.array("f4", [m]),
  ];
  const [faults, counters] = [arena.array("b1", [1]), arena.array("i8", [COUNTERS])];
  const args = [tree, [list, arena.array("i8", [0, 3])], anyHit, hits, faults, counters];
  kernels.run("antumbra.trace.rays.ray_batches:_blocks", Math.ceil(n / RAYS), BATCHES, ...args);
  return faults.view[0] ? null : hits;
}

/**
 * Which segments are blocked.
 * @param {KernelInstance} kernels
 * @param {any[]} tree a `WideBvh`
 * @param {MemoryArray} origins (n, 3) float32 in the frame
 * @param {MemoryArray} ends (n, 3)
 * @param {number} cull a value of CULL_FACES
 * @returns {Uint8Array} valid until other arrays are made
 */
export function blockedSegments(kernels, tree, origins, ends, cull) {
  const n = origins.shape[0];
  const points = [origins, ends].map(({ address }) => [address, 12, 4, 0]);
  const list = [...points, [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, -1], [0, 0, 0], n, cull, true];
  const hits = traceRays(kernels, tree, list, n, true);
  if (!hits) throw new RangeError("a point or the light is beyond float32; move it nearer");
  return hits[0].view;
}
