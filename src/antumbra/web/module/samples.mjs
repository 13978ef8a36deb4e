// @ts-check
/** The 16 sample sets of a light, as `antumbra.query.light_samples` has them with its default sampler and seed 0. */

import { sinCos } from "./elementary.mjs";

export const SETS = 16;
export const MOST_SAMPLES = 1024;

/** @typedef {"square" | "disk" | "hemisphere" | "point"} Domain */

/** The latest sets, since calls repeat. @type {{n: number, domain: Domain, sets: Float64Array} | null} */
let latest = null;

/**
 * (16, n, 3) numbers: the samples (a, b, c) on a domain. Do not write to them.
 * @param {number} n
 * @param {Domain} domain
 */
export function sampleSets(n, domain) {
  if (latest?.n === n && latest.domain === domain) return latest.sets;
  const sets = new Float64Array(SETS * n * 3);
  if (domain !== "point")
    splitNet(n).forEach(([x, y], at) => {
      const [a, b] = domain === "square" ? [x, y] : concentric(x, y);
      const height = domain === "hemisphere" ? Math.sqrt(Math.max(1 - a * a - b * b, 0)) : 0;
      sets.set([a, b, height], 3 * at);
    });
  latest = { n, domain, sets };
  return sets;
}

/**
 * The 16 n points on the unit square, set by set. The net of 16 m points has 16 in each of m cells; each set takes one
 * of each cell, and a set of n < m points keeps cells that are well distributed.
 * @param {number} n
 */
function splitNet(n) {
  const m = 2 ** Math.ceil(Math.log2(n));
  const bits = Math.log2(m);
  const [nx, ny] = [2 ** ((bits + 1) >> 1), 2 ** (bits >> 1)];
  /** @type {number[][][]} */
  const cells = Array.from({ length: m }, () => []);
  for (let i = 0; i < SETS * m; i++) {
    const [x, y] = [(i + 0.5) / (SETS * m), larcherPillichshammer(i)];
    cells[Math.floor(y * ny) * nx + Math.floor(x * nx)].push([x, y]); // ascending in x
  }
  const order = Array.from({ length: m }, (_, cell) => cell);
  const place = order.map((cell) => zOrder(cell % nx, Math.floor(cell / nx)));
  order.sort((one, other) => place[one] - place[other]);
  const kept = order.filter((_, at) => reversed(at, bits) < n);
  const points = [];
  for (let set = 0; set < SETS; set++)
    for (const cell of kept) {
      const [column, row] = [cell % nx, Math.floor(cell / nx)];
      points.push(cells[cell][set ^ reversed(row & 15, 4) ^ (column & 15)]);
    }
  return points;
}

/** The inverse of i by Larcher and Pillichshammer [Kollig and Keller 2002]. @param {number} i */
function larcherPillichshammer(i) {
  let [out, row] = [0, 0x80000000];
  for (let rest = i; rest > 0; rest >>>= 1) {
    if (rest & 1) out ^= row;
    row = (row >>> 1) | 0x80000000;
  }
  return ((out >>> 0) + 0.5) / 2 ** 32;
}

/** The last bits of a number in reverse order. @param {number} value @param {number} bits */
function reversed(value, bits) {
  let out = 0;
  for (let k = 0; k < bits; k++) out |= ((value >> k) & 1) << (bits - 1 - k);
  return out;
}

/** The place of a cell on the Z curve. @param {number} column @param {number} row */
function zOrder(column, row) {
  let out = 0;
  for (let k = 0; k < 6; k++) out |= (((column >> k) & 1) << (2 * k)) | (((row >> k) & 1) << (2 * k + 1));
  return out;
}

/** A point of the unit square on the unit disk [Shirley and Chiu 1997]. @param {number} a @param {number} b */
function concentric(a, b) {
  const [x, y] = [2 * a - 1, 2 * b - 1];
  const wide = Math.abs(x) > Math.abs(y);
  const r = wide ? x : y;
  const angle = wide ? (Math.PI / 4) * (y / x) : Math.PI / 2 - (Math.PI / 4) * (x / y);
  const [sine, cosine] = sinCos(r === 0 ? 0 : angle);
  return [r * cosine, r * sine];
}
