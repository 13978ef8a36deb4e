// @ts-check
/** Checks of what scenes and their queries are given. */

/** @typedef {import("./scene.mjs").RayOptions} RayOptions */

/**
 * @param {Float32Array} positions
 * @param {ArrayLike<number> | null} indices
 */
export function checkMesh(positions, indices) {
  if (!(positions instanceof Float32Array)) throw new TypeError("positions must be a Float32Array");
  const vertices = positions.length / 3;
  const corners = indices ? indices.length : vertices;
  if (!Number.isInteger(vertices) || !Number.isInteger(corners / 3) || corners === 0)
    throw new RangeError("a scene needs whole triangles: three coordinates a vertex, and three vertices a triangle");
  const bad = positions.findIndex((x) => !Number.isFinite(x));
  if (bad >= 0) throw new RangeError(`positions: vertex ${Math.floor(bad / 3)} is not finite`);
  for (let i = 0; indices && i < corners; i++)
    if (!(indices[i] >= 0 && indices[i] < vertices))
      throw new RangeError(`indices: ${indices[i]} at ${i} is no vertex; there are ${vertices}`);
}

/**
 * The number of rays, whose arrays have been checked.
 * @param {ArrayLike<number>} origins
 * @param {ArrayLike<number> | null} directions
 * @param {RayOptions} options
 */
export function checkRays(origins, directions, { targets, tmin, tmax, skipFace, cullFaces }) {
  const n = origins.length / 3;
  if (!Number.isInteger(n)) throw new RangeError("origins must have three numbers a ray");
  if (Boolean(directions) === Boolean(targets)) throw new TypeError("give either directions or targets");
  if (targets && (tmin !== undefined || tmax !== undefined)) throw new TypeError("segments take no tmin and no tmax");
  const lengths = {
    directions: [directions, 3],
    targets: [targets, 3],
    tmin: [tmin, 1],
    tmax: [tmax, 1],
    skipFace: [skipFace, 1],
  };
  for (const [name, [value, each]] of Object.entries(lengths)) {
    const size = /** @type {any} */ (value)?.length;
    if (size !== undefined && size !== n * /** @type {number} */ (each))
      throw new RangeError(`${name} has ${size} numbers, and ${n} rays need ${n * /** @type {number} */ (each)}`);
  }
  cullOf(cullFaces);
  return n;
}

/**
 * A value of CULL_FACES.
 * @param {"front" | "back" | undefined} cullFaces
 */
export function cullOf(cullFaces) {
  if (cullFaces !== undefined && cullFaces !== "front" && cullFaces !== "back")
    throw new TypeError(`cullFaces is ${cullFaces}; it must be "front" or "back"`);
  return cullFaces === undefined ? 0 : cullFaces === "back" ? 1 : -1;
}

/**
 * @param {ArrayLike<number>} points
 * @param {ArrayLike<number> | null} normals
 */
export function checkPoints(points, normals) {
  if (!Number.isInteger(points?.length / 3)) throw new RangeError("points must have three numbers each");
  if (normals && normals.length !== points.length)
    throw new RangeError(`normals has ${normals.length} numbers, and the points have ${points.length}`);
}

/**
 * What is wrong with the first invalid ray.
 * @param {ArrayLike<number>} origins
 * @param {ArrayLike<number> | null} directions
 * @param {RayOptions} options
 * @param {number} first
 * @param {number} end
 */
export function faultOf(origins, directions, { targets, tmin = 0, tmax = Infinity }, first, end) {
  const finite = (/** @type {ArrayLike<number>} */ values, /** @type {number} */ ray) =>
    [0, 1, 2].every((k) => Number.isFinite(Math.fround(values[3 * ray + k])));
  const numberOf = (/** @type {number | ArrayLike<number>} */ value, /** @type {number} */ ray) =>
    typeof value === "number" ? value : value[ray];
  for (let ray = first; ray < end; ray++) {
    if (!finite(origins, ray)) return `origins hold NaN or infinity, or are beyond float32 (ray ${ray})`;
    const ends = /** @type {ArrayLike<number>} */ (targets ?? directions);
    if (!finite(ends, ray))
      return `${targets ? "targets" : "directions"} hold NaN or infinity, or are beyond float32 (ray ${ray})`;
    if (!targets && [0, 1, 2].every((k) => Math.fround(ends[3 * ray + k]) === 0))
      return `direction of ray ${ray} is zero in float32; give every ray a direction`;
    const low = numberOf(tmin, ray);
    if (!(low >= 0 && low < Infinity)) return `tmin must be finite and not negative (ray ${ray})`;
    if (Number.isNaN(numberOf(tmax, ray))) return `tmax is NaN (ray ${ray})`;
  }
  return "rays are invalid";
}
