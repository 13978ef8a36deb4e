// @ts-check
/** Trees: a BVH by binned SAH, built by one thread, and its eight-wide form (`antumbra.bvh`). */

import { exponentOf } from "./vectors.mjs";

/** @typedef {import("./kernels.mjs").KernelInstance} KernelInstance */
/** @typedef {import("./memory.mjs").MemoryArray} MemoryArray */

/**
 * A binary BVH, as kernels take it: nodes, links, the triangle of each slot, its corners.
 * @typedef {[MemoryArray, MemoryArray, MemoryArray, MemoryArray]} Bvh
 */

/**
 * The eight-wide form: nodes, links, groups of triangles, their slots, the scene's reach along each axis, the binary BVH.
 * @typedef {[MemoryArray, MemoryArray, MemoryArray, MemoryArray, number[], Bvh]} WideBvh
 */

const MAX_LEAF = 4; // triangles
const SHARE = 4096; // triangles that are bounded at a time
const BOUNDS = 20; // numbers of a share's bounds: a box, the box of the centroids, faults
const BIN_WORDS = 1024; // scratch memory of a division
const WIDTH = 8; // children of a wide node, and triangles of a group
const NODE_WORDS = 8 * WIDTH;
const GROUP_WORDS = 10 * WIDTH;
const LEAF = -1; // the link to a leaf of one triangle in slot 0
const EMPTY = -(2 ** 31);

/**
 * Build a BVH over triangles, (n, 9), n >= 1.
 * @param {KernelInstance} kernels
 * @param {MemoryArray} triangles
 * @returns {Bvh}
 */
export function buildTree(kernels, triangles) {
  const { arena } = kernels;
  const n = triangles.shape[0];
  const ids = arena.array("i4", [n]);
  const corners = arena.array("f4", [n, 9]);
  if (n === 1) return [...leafAlone(kernels, triangles), ids, triangles];
  const nodes = arena.array("f4", [n, 16]);
  const links = nodes.as("i4", [n, 16]);
  arena.scratch(() => {
    const records = arena.array("f4", [n, 8]);
    const box = boundTriangles(kernels, triangles, records);
    const settings = [MAX_LEAF, areaScale(box)];
    const range = arena.array("f4", [1, 16], box);
    const ranges = arena.array("i8", [1, 3], [0n, BigInt(n), 0n]);
    const top = [arena.array("f4", [0, 2, 8]), arena.array("i8", [0, 2]), ranges, range, null];
    const order = arena.array("i8", [1]);
    const shares = arena.array("i8", [1, 3]);
    const built = arena.array("f4", [n, 16]);
    const method = [records, arena.array("f4", [n, 8])];
    const memory = [arena.array("f4", [n, 16]), arena.array("f4", [BIN_WORDS])];
    const bvh = [built, built.as("i4", [n, 16]), ids, corners];
    const next = arena.array("i8", [1]);
    const args = [triangles, method, top, order, settings, bvh, [built, shares], next, memory];
    kernels.run("antumbra.bvh.top_down:_build_subtrees", 1, 1, ...args);
    kernels.run("antumbra.bvh.top_levels:_copy_subtrees", 1, 1, [built, shares], order, nodes, links);
    nodes.shape[0] = links.shape[0] = Number(shares.view[1]);
  });
  return [nodes, links, ids, corners];
}

/**
 * The one node of a tree over one triangle.
 * @param {KernelInstance} kernels
 * @param {MemoryArray} triangle
 */
function leafAlone(kernels, triangle) {
  const node = kernels.arena.array("f4", [1, 16]);
  for (let axis = 0; axis < 3; axis++) {
    const values = [0, 3, 6].map((corner) => triangle.view[corner + axis]);
    node.view.set([Math.min(...values), Infinity, Math.max(...values), -Infinity], 4 * axis);
  }
  const links = node.as("i4", [1, 16]);
  links.view.set([LEAF, EMPTY], 12);
  return /** @type {[MemoryArray, MemoryArray]} */ ([node, links]);
}

/**
 * Write the records of triangles, and return their box and that of their centroids, 8 numbers each.
 * @param {KernelInstance} kernels
 * @param {MemoryArray} triangles
 * @param {MemoryArray} records
 */
function boundTriangles(kernels, triangles, records) {
  const n = triangles.shape[0];
  const shares = Math.ceil(n / SHARE);
  const parts = kernels.arena.array("f4", [shares, BOUNDS]);
  kernels.run("antumbra.bvh.triangle_bounds:write_records", n, SHARE, triangles, records, parts);
  const box = new Float32Array(16).fill(Infinity);
  for (let share = 0; share < shares; share++)
    for (let k = 0; k < 16; k++) box[k] = Math.min(box[k], parts.view[share * BOUNDS + k]);
  return box;
}

/**
 * A power of two that scales the largest coordinate to about 1, so that no area overflows.
 * @param {Float32Array} box
 */
function areaScale(box) {
  const largest = Math.max(...[0, 1, 2, 4, 5, 6].map((k) => Math.abs(box[k])));
  return largest > 0 ? 2 ** Math.min(126, -exponentOf(largest)) : 1;
}

/**
 * The eight-wide form of a BVH (`antumbra.bvh.wide_bvh.widen`).
 * @param {KernelInstance} kernels
 * @param {Bvh} bvh
 * @returns {WideBvh}
 */
export function widen(kernels, bvh) {
  const { arena } = kernels;
  const n = bvh[0].shape[0];
  const words = arena.array("f4", [n, NODE_WORDS]); // more than are used
  const slots = arena.array("i4", [n + 1, WIDTH]);
  const [nodeCount, , groupCount] = arena.scratch(() => {
    const [order, costs, counts] = [
      arena.array("i4", [n]),
      arena.array("f4", [2 * n, WIDTH]),
      arena.array("i4", [2 * n]),
    ];
    const m = kernels.call("antumbra.bvh.nodes:write_parents_first", bvh[1], 0, order);
    const prices = [costs, counts, arena.array("i4", [n, WIDTH])];
    kernels.call("antumbra.bvh.wide_bvh:_price", bvh, order, m, prices);
    const all = [bvh, prices, n + 1, order];
    kernels.call("antumbra.bvh.wide_bvh:_collapse_top", ...all, null);
    const out = [words, words.as("i4", words.shape), slots];
    return kernels.call("antumbra.bvh.wide_bvh:_collapse_top", ...all, out);
  });
  const nodes = words.as("f4", [nodeCount, NODE_WORDS]);
  const links = words.as("i4", [nodeCount, NODE_WORDS]);
  const size = Math.max(1, groupCount);
  if (groupCount === 0) slots.view.fill(-1, 0, WIDTH);
  const groupSlots = slots.as("i4", [size, WIDTH]);
  const groups = arena.array("f4", [size, GROUP_WORDS]);
  arena.scratch(() => {
    const areas = arena.array("f8", [size]);
    kernels.run("antumbra.bvh.wide_bvh:_fill_groups", size, 256, bvh[3], groupSlots, groups, areas);
    const scratch = [arena.array("f8", [nodeCount]), arena.array("f8", [nodeCount])];
    kernels.call("antumbra.bvh.child_order:_sort_by_cost", nodes, links, areas, ...scratch, 0, nodeCount);
  });
  return [nodes, links, groups, groupSlots, reachOf(nodes), bvh];
}

/**
 * The largest magnitude of a coordinate along each axis, over the boxes of the root's children.
 * @param {MemoryArray} nodes
 */
function reachOf(nodes) {
  const planes = nodes.view.subarray(0, 6 * WIDTH);
  return [0, 1, 2].map((axis) => {
    let largest = 0;
    for (let lane = 0; lane < WIDTH; lane++) {
      if (planes[lane] > planes[WIDTH + lane]) continue; // no child
      const low = planes[2 * axis * WIDTH + lane];
      const high = planes[(2 * axis + 1) * WIDTH + lane];
      largest = Math.max(largest, Math.abs(low), Math.abs(high));
    }
    return largest;
  });
}
