// @ts-check
/** Surfaces in the colours of their numbers, shaded so little that the colours are near those of the legend. */

import { AMBIENT } from "./lamps.mjs";

/** @typedef {import("../module/memory.mjs").MemoryArray} MemoryArray */

const DARKEST = 0.45; // share of a colour without light

/**
 * Replace the light of white surfaces by the colours of their numbers.
 * @param {any} surfaces arrays of a `GBuffer`
 * @param {import("./surface_values.mjs").SurfaceValues} values
 * @param {number[]} origin of the places of surfaces
 * @param {number[]} ambient light, which tells how much light arrives in the mean
 * @param {MemoryArray} image
 */
export function paint({ ids, position, normal }, values, origin, ambient, image) {
  const [faces, places, normals, out] = [ids.view, position.view, normal.view, image.view];
  const bright = luminance(ambient, 0) / AMBIENT / Math.PI;
  for (let i = 0; i < faces.length; i++) {
    if (faces[i] < 0) continue;
    const point = origin.map((o, k) => o + places[3 * i + k]);
    const colour = values.colour(faces[i], point, Array.from(normals.subarray(3 * i, 3 * i + 3)));
    const light = bright > 0 ? Math.min(1, luminance(out, 3 * i) / bright) : 1;
    for (let k = 0; k < 3; k++) out[3 * i + k] = colour[k] * (DARKEST + (1 - DARKEST) * light);
  }
}

/** @param {ArrayLike<number>} light @param {number} at */
function luminance(light, at) {
  return 0.2126 * light[at] + 0.7152 * light[at + 1] + 0.0722 * light[at + 2];
}
