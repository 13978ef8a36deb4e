// @ts-check
/** Hours of direct sun at points: which suns they see, summed (`antumbra.sun_hours`). */

import { MOST_SAMPLES } from "./samples.mjs";

const BUNDLE = 16; // suns that share shafts

/**
 * The hours of sun of n points.
 * @param {number} n
 * @param {import("./sun.mjs").Suns} suns
 * @param {(light: import("./lights.mjs").Light) => import("./shadows.mjs").Visibility} see what the points see of a light
 * @returns {Float64Array} NaN for a point that is not finite, or whose normal is not
 */
export function sumHours(n, { directions, hours }, see) {
  const out = new Float64Array(n);
  for (let first = 0; first < hours.length; first += MOST_SAMPLES) {
    const some = Math.min(MOST_SAMPLES, hours.length - first);
    const ways = Array.from({ length: some }, (_, k) => [0, 1, 2].map((axis) => directions[3 * (first + k) + axis]));
    const order = bundled(ways);
    const light = { kind: /** @type {const} */ ("suns"), directions: order.flatMap((k) => ways[k].map((x) => -x)) };
    const { bits, fraction } = see(light);
    const words = bits.length / n;
    const places = new Int32Array(some);
    order.forEach((k, place) => {
      places[k] = place;
    });
    for (let i = 0; i < n; i++) {
      for (let k = 0; k < some; k++) {
        const place = places[k];
        if (((bits[i * words + (place >> 5)] >>> (place & 31)) & 1) === 0) out[i] += hours[first + k];
      }
      if (Number.isNaN(fraction[i])) out[i] = Number.NaN;
    }
  }
  return out;
}

/**
 * An order of directions in which each 16 are close together: halved again and again along their widest axis.
 * @param {number[][]} ways
 */
function bundled(ways) {
  const [out, waiting] = [/** @type {number[]} */ ([]), [ways.map((_, k) => k)]];
  for (let group = waiting.pop(); group; group = waiting.pop()) {
    if (group.length <= BUNDLE) {
      out.push(...group);
      continue;
    }
    const members = group;
    const widths = [0, 1, 2].map((axis) => {
      const values = members.map((k) => ways[k][axis]);
      return Math.max(...values) - Math.min(...values);
    });
    const axis = widths.indexOf(Math.max(...widths));
    group.sort((one, other) => ways[one][axis] - ways[other][axis]);
    const half = (Math.ceil(group.length / BUNDLE) >> 1) * BUNDLE;
    waiting.push(group.slice(half), group.slice(0, half));
  }
  return out;
}
