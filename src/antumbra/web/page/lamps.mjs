// @ts-check
/** The lights of a picture, as its kernels take them (`antumbra.scene.lights`, `light_list_irradiance`). */

import { KINDS, patchOf } from "../module/lights.mjs";
import { SETS } from "../module/samples.mjs";

/** @typedef {import("../module/lights.mjs").Patch} Patch */

/**
 * A light: `tint` is its colour times its intensity. A list has the samples and the 12 numbers of each light in each set in
 * columns. The sun that moves has no direction.
 * @typedef {{kind: string, tint: number[], daylight: boolean, moves?: boolean, smooth?: boolean, distant?: boolean, facing?: boolean,
 *   least?: number, samples?: Float64Array, values?: Float32Array, [name: string]: any}} Lamp
 */

export const SAMPLES_A_PASS = 16;
export const AMBIENT = 0.12; // share of the light that arrives, as in antumbra.picture.shading
const STEP = 5; // places that the sets of a pixel move with each pass; odd
const [FIELDS, CANDELA] = [12, 9]; // of a light of a list: position, rounding, normal, and then candela
const [POINT, QUAD, DISK] = [0, 1, 2]; // forms of an `Emitter`

/**
 * The patch of a light in a pass. Each pass gives a pixel another one of the 16 sample sets.
 * @param {Lamp} lamp
 * @param {number[] | null} sun towards the sun that moves
 * @param {number} pass
 * @param {number[]} origin
 * @param {number} reach
 * @returns {Patch}
 */
export function lampPatch(lamp, sun, pass, origin, reach) {
  if (lamp.kind === "list") {
    const [u, v, w] = [0, 1, 2].map((axis) => [0, 1, 2].map((k) => (k === axis ? (lamp.distant ? reach : 1) : 0)));
    const base = lamp.distant ? [0, 0, 0] : origin.map((x) => -x);
    const samples = /** @type {Float64Array} */ (lamp.samples);
    const n = samples.length / SETS / 3;
    const kind = lamp.distant ? KINDS.DIRECTIONAL : KINDS.LIST;
    return { kind, axes: [base, u, v, w], radius: 0, n, traced: n, samples: turned(samples, pass) };
  }
  const light = lamp.moves ? { ...lamp, direction: sun?.map((x) => -x) } : lamp;
  const patch = patchOf(/** @type {any} */ (light), SAMPLES_A_PASS, origin, reach);
  return { ...patch, samples: turned(patch.samples, pass) };
}

/**
 * The sets of samples, or of numbers of lights, in another order.
 * @template {Float64Array | Float32Array} T
 * @param {T} sets 16 of equal length
 * @param {number} pass
 * @returns {T}
 */
function turned(sets, pass) {
  if (pass === 0) return sets;
  const size = sets.length / SETS;
  const out = /** @type {T} */ (sets.slice());
  for (let set = 0; set < SETS; set++) {
    const from = ((set + STEP * pass) % SETS) * size;
    out.set(/** @type {any} */ (sets.subarray(from, from + size)), set * size);
  }
  return out;
}

/**
 * The arguments of an `Emitter`.
 * @param {Lamp} lamp
 * @param {Patch} patch
 */
export function emitterOf({ kind }, { kind: patchKind, axes: [base, u, v], radius }) {
  const across = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  const area = Math.hypot(...across);
  const none = [0, 0, 0];
  if (patchKind === KINDS.SPHERE) return [patchKind, DISK, ...base, ...u, ...v, ...none, radius];
  if (area === 0) return [patchKind, POINT, ...base, ...u, ...v, ...none, 0];
  const axis = across.map((x) => x / area);
  return kind === "quad"
    ? [patchKind, QUAD, ...base, ...u, ...v, ...axis, area]
    : [patchKind, DISK, ...base, ...u, ...v, ...axis, Math.sqrt(area)];
}

/**
 * The arguments of `ListedLights`: for each row y mod 4 of pixels, the lights as vectors of eight columns.
 * @param {import("../module/memory.mjs").Arena} arena
 * @param {Lamp} lamp
 * @param {number} pass
 * @param {number} share of its intensity
 */
export function listedLights(arena, lamp, pass, share) {
  const values = turned(/** @type {Float32Array} */ (lamp.values), pass);
  const n = values.length / SETS / FIELDS;
  const vectors = arena.array("f4", [4, n, FIELDS, 8]);
  const out = vectors.view;
  for (let row = 0; row < 4; row++)
    for (let s = 0; s < n; s++)
      for (let field = 0; field < FIELDS; field++)
        for (let x = 0; x < 8; x++) {
          const value = values[(((x & 3) + 4 * row) * n + s) * FIELDS + field];
          out[((row * n + s) * FIELDS + field) * 8 + x] = field < CANDELA ? value : value * share;
        }
  return [vectors, Boolean(lamp.distant), Boolean(lamp.facing), lamp.least ?? 0];
}
