// @ts-check
/** The frame of a scene's float32 coordinates (`antumbra.scene.scene_bounds`), and receivers in it. */

import { toWhole } from "./elementary.mjs";
import { exponentOf, unitOf } from "./vectors.mjs";

/** @typedef {[number[], number[]]} Box lower and upper corner */

const NEAR = 16; // widest extents within which the frame keeps its origin at 0
const NEAREST = 2 ** -110; // coordinates in the frame with smaller magnitudes are 0
const MAX_EXTENT = 1e18;
const SHIFT = 2 ** -21; // of a receiver off its surface, in units of its coordinates
const NOTHING = 0; // no receiver
const SURFACE = 1;
const FREE = 2; // a point in free space

/**
 * The lower and the upper corner of points.
 * @param {ArrayLike<number>} positions
 * @returns {Box}
 */
export function boundsOf(positions) {
  const [lower, upper] = [
    [Infinity, Infinity, Infinity],
    [-Infinity, -Infinity, -Infinity],
  ];
  for (let i = 0; i < positions.length; i++) {
    const axis = i % 3;
    lower[axis] = Math.min(lower[axis], positions[i]);
    upper[axis] = Math.max(upper[axis], positions[i]);
  }
  return [lower, upper];
}

/**
 * The origin of the frame: 0 on axes on which the scene lies near it, otherwise its centre in float32.
 * @param {Box} bounds
 */
export function frameOrigin([lower, upper]) {
  const extent = Math.max(...lower.map((low, axis) => upper[axis] - low));
  if (!(extent <= MAX_EXTENT))
    throw new RangeError(`positions reach over ${extent}; they must be finite and at most 1e18 wide`);
  if (!(extent > 1e-200)) return lower;
  return lower.map((low, axis) => {
    const near = Math.max(Math.abs(low), Math.abs(upper[axis])) <= NEAR * extent;
    return near ? 0 : Math.fround(low / 2 + upper[axis] / 2);
  });
}

/**
 * The middle of the scene, from which the rounding errors of points are measured, too.
 * @param {Box} bounds
 */
export function middleOf([lower, upper]) {
  const extent = Math.max(...lower.map((low, axis) => upper[axis] - low));
  if (!(extent > 1e-200)) return lower;
  const step = 2 ** (exponentOf(extent) - 21);
  return lower.map((low, axis) => low + toWhole((upper[axis] - low) / 2 / step) * step);
}

/**
 * A coordinate in the frame; 0 if it is tiny.
 * @param {number} local
 */
export function flushed(local) {
  return Math.abs(local) < NEAREST ? 0 : local;
}

/**
 * Write the corners of all triangles, relative to the frame.
 * @param {Float32Array} positions
 * @param {ArrayLike<number> | null} indices
 * @param {number[]} origin
 * @param {Float32Array} out
 */
export function recentre(positions, indices, origin, out) {
  for (let corner = 0; corner < out.length / 3; corner++) {
    const vertex = indices ? indices[corner] : corner;
    for (let axis = 0; axis < 3; axis++)
      out[3 * corner + axis] = flushed(Math.fround(positions[3 * vertex + axis] - origin[axis]));
  }
}

/**
 * Points to ask about, in the frame: `antumbra.query.receivers.Receivers`.
 * @typedef {object} Receivers
 * @property {Float32Array} origins moved off their surfaces
 * @property {Int8Array} sides whether each is a point on a surface, in free space, or nothing
 * @property {Float64Array | null} normals of unit length
 * @property {number[]} failed the points that are not finite, or whose normal is not or is zero
 */

/**
 * The receivers at points. With normals, they are moved off their surfaces by a few units in the last place.
 * @param {ArrayLike<number>} points
 * @param {ArrayLike<number> | null} normals of any length
 * @param {number[]} origin of the frame
 * @param {number[]} middle of the scene
 * @returns {Receivers}
 */
export function receiversOf(points, normals, origin, middle) {
  const n = points.length / 3;
  const single = points instanceof Float32Array;
  const apart = middle.some((x, axis) => x !== origin[axis]);
  const origins = new Float32Array(3 * n);
  const sides = new Int8Array(n).fill(normals ? SURFACE : FREE);
  const units = normals ? new Float64Array(3 * n) : null;
  const failed = [];
  for (let i = 0; i < 3 * n; i += 3) {
    const largest = normals ? greatest(normals[i], normals[i + 1], normals[i + 2]) : 1;
    const world = greatest(points[i], points[i + 1], points[i + 2]);
    if (!Number.isFinite(world) || !Number.isFinite(largest) || largest === 0) {
      sides[i / 3] = NOTHING;
      failed.push(i / 3);
      continue;
    }
    const local = [points[i] - origin[0], points[i + 1] - origin[1], points[i + 2] - origin[2]];
    if (local.some((x) => !Number.isFinite(Math.fround(x))))
      throw new RangeError(`point ${i / 3} lies beyond float32, farther than 3.4e38 from the scene; move it closer`);
    if (!normals || !units) {
      for (let axis = 0; axis < 3; axis++) origins[i + axis] = flushed(Math.fround(local[axis]));
      continue;
    }
    const normal = unitOf([normals[i], normals[i + 1], normals[i + 2]], largest);
    let size = greatest(local[0], local[1], local[2]);
    if (apart)
      size = Math.max(size, greatest(points[i] - middle[0], points[i + 1] - middle[1], points[i + 2] - middle[2]));
    let shift = SHIFT * size;
    if (single) shift += (SHIFT / 4) * world;
    for (let axis = 0; axis < 3; axis++) {
      units[i + axis] = normal[axis];
      origins[i + axis] = flushed(local[axis] + shift * normal[axis]);
    }
  }
  placeFailed(origins, units, failed, n);
  return { origins, sides, normals: units, failed };
}

/** The largest magnitude of three numbers. @param {number} x @param {number} y @param {number} z */
function greatest(x, y, z) {
  return Math.max(Math.abs(x), Math.abs(y), Math.abs(z));
}

/**
 * Put the points that fail where the first other one is, so that they do not widen bounds.
 * @param {Float32Array} origins
 * @param {Float64Array | null} units
 * @param {number[]} failed ascending
 * @param {number} n
 */
function placeFailed(origins, units, failed, n) {
  if (failed.length === 0) return;
  if (failed.length === n)
    throw new RangeError("no point is left: points or normals hold NaN or infinity, or normals are zero");
  let good = 0;
  while (failed[good] === good) good++;
  for (const i of failed) {
    origins.copyWithin(3 * i, 3 * good, 3 * good + 3);
    units?.copyWithin(3 * i, 3 * good, 3 * good + 3);
  }
}
