// @ts-check
/** Lights, and the patches of sample points that they are for kernels (`antumbra.scene.lights`). */

import { tan } from "./elementary.mjs";
import { flushed } from "./frame.mjs";
import { MOST_SAMPLES, SETS, sampleSets } from "./samples.mjs";
import { tangents, unit, vector } from "./vectors.mjs";

/** @typedef {import("./vectors.mjs").Vector} Vector */

/**
 * A light, in the coordinates of the scene.
 *
 * - `point`: without extent. `quad`: the parallelogram corner + a u + b v. `disk`, `sphere`: around a centre.
 * - `sun`: a distant disk, with the direction from it into the scene and its diameter in degrees, 0.53 if it is left out.
 * - `ambient`: the sky around the normal of each point, which sees more of what is above it: the cosine weighs
 *   directions. What is farther than `radius` does not count.
 * - `points`, `suns`: up to 1024 lights without extent, each of which is one sample; three numbers a light.
 * @typedef {{kind: "point", position: Vector}
 *   | {kind: "quad", corner: Vector, u: Vector, v: Vector}
 *   | {kind: "disk", center: Vector, normal: Vector, radius: number}
 *   | {kind: "sphere", center: Vector, radius: number}
 *   | {kind: "sun", direction: Vector, angularDiameter?: number}
 *   | {kind: "ambient", radius?: number}
 *   | {kind: "points", positions: ArrayLike<number>}
 *   | {kind: "suns", directions: ArrayLike<number>}} Light
 */

/**
 * What kernels get of a light: a `LightPatch`, and 16 sets of n samples (a, b, c).
 * @typedef {object} Patch
 * @property {number} kind a value of KINDS
 * @property {number[][]} axes base, u, v and w
 * @property {number} radius
 * @property {number} n samples of a point
 * @property {number} traced samples that are traced: 1 if all are the same
 * @property {Float64Array} samples (16, traced, 3)
 */

export const KINDS = { FIXED: 0, DIRECTIONAL: 1, SPHERE: 2, LIST: 3, AMBIENT: 4 };

const FARTHEST = 2 ** 125; // sums of two such coordinates are finite in float32
const SUN = 0.53; // degrees
const FLAT = [-0, -0, -0];
const NONE = [0, 0, 0];

/**
 * The patch of a light.
 * @param {Light} light
 * @param {number} samples of each point; lists have their own number
 * @param {number[]} origin of the frame
 * @param {number} reach a length greater than the distance of any point from the scene
 * @returns {Patch}
 */
export function patchOf(light, samples, origin, reach) {
  const made = light?.kind in MAKERS ? MAKERS[light.kind](light, origin, reach) : null;
  if (!made) throw new TypeError(`the light is of kind ${light?.kind}; give one of ${Object.keys(MAKERS).join(", ")}`);
  if (!made.list && !(Number.isInteger(samples) && samples >= 1 && samples <= MOST_SAMPLES))
    throw new RangeError(`samples is ${samples}; it must be a whole number from 1 to ${MOST_SAMPLES}`);
  const traced = made.domain === "point" ? 1 : (made.list?.length ?? samples);
  const sets = made.list ? repeated(made.list, light.kind) : sampleSets(traced, made.domain);
  const n = made.list ? traced : samples;
  return { kind: made.kind, axes: made.axes, radius: made.radius ?? 0, n, traced, samples: sets };
}

/** @type {Record<string, (light: any, origin: number[], reach: number) => any>} */
const MAKERS = {
  point: ({ position }, origin) => fixed(place(position, "the position of the light"), NONE, NONE, origin, "point"),
  quad({ corner, u, v }, origin) {
    const [at, one, other] = [place(corner, "corner"), vector(u, "u"), vector(v, "v")];
    for (const sum of [add(at, one), add(at, other), add(add(at, one), other)]) place(sum, "corner");
    if (!(area(one, other) > 0)) throw new RangeError("the quad has no area (u and v are parallel or zero)");
    return fixed(at, one, other, origin, "square");
  },
  disk({ center, normal, radius }, origin) {
    const [u, v] = tangents(unit(vector(normal, "normal"), "normal"));
    const axes = round(center, radius);
    return fixed(axes, scaled(u, radius), scaled(v, radius), origin, "disk");
  },
  sphere: ({ center, radius }, origin) => ({
    ...fixed(round(center, radius), NONE, NONE, origin, "disk"),
    kind: KINDS.SPHERE,
    radius,
  }),
  sun({ direction, angularDiameter = SUN }, _, reach) {
    const way = unit(vector(direction, "direction"), "direction");
    if (!(angularDiameter >= 0 && angularDiameter < 180))
      throw new RangeError(`angularDiameter is ${angularDiameter}; it must be from 0 to below 180 degrees`);
    const radius = reach * tan((angularDiameter * (Math.PI / 180)) / 2);
    if (!(Math.hypot(reach, radius) < FARTHEST))
      throw new RangeError("the sun is too far away; make the scene smaller");
    const [u, v] = tangents(way);
    const axes = [scaled(scaled(way, -1), reach), scaled(u, radius), scaled(v, radius), FLAT];
    return { kind: KINDS.DIRECTIONAL, axes, domain: angularDiameter === 0 ? "point" : "disk" };
  },
  ambient({ radius = Infinity }, _, reach) {
    if (!(radius > 0)) throw new RangeError(`radius is ${radius}; it must be positive`);
    const axes = [NONE, NONE, NONE, NONE];
    return { kind: KINDS.AMBIENT, axes, radius: Math.min(radius, reach), domain: "hemisphere" };
  },
  points({ positions }, origin) {
    const list = rows(positions, "positions").map((row) => place(row, "a position"));
    const axes = [origin.map((x) => -x), [1, 0, 0], [0, 1, 0], [0, 0, 1]];
    return { kind: KINDS.LIST, axes, list };
  },
  suns({ directions }, _, reach) {
    const list = rows(directions, "directions").map((row) => scaled(unit(row, "a direction"), -1));
    const axes = [NONE, [reach, 0, 0], [0, reach, 0], [0, 0, reach]];
    return { kind: KINDS.DIRECTIONAL, axes, list };
  },
};

/**
 * @param {number[]} base
 * @param {number[]} u
 * @param {number[]} v
 * @param {number[]} origin
 * @param {import("./samples.mjs").Domain} domain
 */
function fixed(base, u, v, origin, domain) {
  const local = base.map((x, axis) => x - origin[axis]);
  return { kind: KINDS.FIXED, axes: [...[local, u, v].map((each) => each.map(flushed)), FLAT], domain };
}

/** @param {number[][]} list */
function repeated(list, /** @type {string} */ kind) {
  if (list.length < 1 || list.length > MOST_SAMPLES)
    throw new RangeError(`the light has ${list.length} ${kind}; give 1 to ${MOST_SAMPLES} a call`);
  return Float64Array.from(Array.from({ length: SETS }, () => list).flat(2));
}

/** @param {ArrayLike<number>} values @param {string} what */
function rows(values, what) {
  if (!Number.isInteger(values?.length / 3)) throw new RangeError(`${what} must have three numbers a light`);
  return Array.from({ length: values.length / 3 }, (_, row) =>
    vector(
      [0, 1, 2].map((k) => values[3 * row + k]),
      `${what} ${row}`,
    ),
  );
}

/** @param {any} at @param {string} what */
function place(at, what) {
  const numbers = vector(at, what);
  if (numbers.some((x) => !(Math.abs(x) < FARTHEST)))
    throw new RangeError(`${what} ${numbers} is beyond 4.3e37; move it nearer`);
  return numbers;
}

/** The centre of a round light. @param {any} center @param {any} radius */
function round(center, radius) {
  if (!(radius > 0 && radius < FARTHEST)) throw new RangeError(`radius is ${radius}; it must be positive and finite`);
  const at = place(center, "center");
  for (const side of [-radius, radius])
    place(
      at.map((x) => x + side),
      "a point at the light's radius",
    );
  return at;
}

/** @param {number[]} v @param {number} by */
const scaled = (v, by) => v.map((x) => x * by);

/** @param {number[]} a @param {number[]} b */
const add = (a, b) => a.map((x, axis) => x + b[axis]);

/** Of a parallelogram. @param {number[]} u @param {number[]} v */
function area(u, v) {
  return Math.hypot(u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]);
}
