// @ts-check
/** Shadows of lists of lights at pixels, by frusta of 16 receivers and one light (`antumbra.trace.frusta.sample_frusta`). */

import { COUNTERS } from "../module/rays.mjs";
import { lightTable, suitsShafts, traceQuery } from "../module/shadows.mjs";

/** @typedef {import("../module/memory.mjs").MemoryArray} MemoryArray */

const [SIDE, LANES, STRATA] = [4, 16, 16]; // pixels of a side of a tile, pixels of a tile, samples of a chunk
const TILES_AT_A_TIME = 4;

/**
 * Trace a query whose 16 sets have different lights.
 * @param {import("../module/shadows.mjs").Geometry} geometry
 * @param {any[]} query the arguments of a `ShadowQuery`
 * @param {import("../module/lights.mjs").Patch} patch
 * @param {MemoryArray} bits (h, w, words)
 */
export function traceBeams(geometry, query, patch, bits) {
  const { kernels, blocks } = geometry;
  if (!blocks || !suitsShafts(geometry, patch, query[0].view)) return traceQuery(geometry, query, patch, bits);
  const { arena } = kernels;
  const { nodes } = blocks;
  const tree = [
    nodes,
    nodes.as("i4", nodes.shape),
    blocks.blocks,
    blocks.bounds,
    blocks.slots,
    blocks.ids,
    blocks.corners,
  ];
  const chunks = Math.ceil(patch.traced / STRATA);
  const parameters = arena.array("f4", [chunks, LANES, 2, STRATA]);
  const out = parameters.view;
  for (let s = 0; s < chunks * STRATA; s++)
    for (let lane = 0; lane < LANES; lane++)
      for (let k = 0; k < 2; k++)
        out[(((s >> 4) * LANES + lane) * 2 + k) * STRATA + (s & 15)] =
          patch.samples[3 * (lane * patch.traced + Math.min(s, patch.traced - 1)) + k];
  const samples = [...lightTable(kernels, query, patch, false), parameters];
  const [h, w] = bits.shape;
  const shape = [SIDE, SIDE, Math.ceil(w / SIDE), Math.ceil(h / SIDE)];
  const counters = arena.array("i8", [COUNTERS]);
  for (let chunk = 0; chunk < chunks; chunk++) {
    const count = Math.min(STRATA, patch.traced - chunk * STRATA);
    const job = [...shape, chunk, count, false, true];
    const args = [tree, query, samples, job, bits, counters, false];
    const n = shape[2] * shape[3];
    kernels.run("antumbra.trace.frusta.sample_frusta:_trace_areas", n, TILES_AT_A_TIME, ...args);
  }
}
