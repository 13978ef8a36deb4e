// @ts-check
/** The tree of blocks of up to 16 triangles, which shafts traverse (`antumbra.bvh.block_tree`). */

/** @typedef {import("./kernels.mjs").KernelInstance} KernelInstance */
/** @typedef {import("./memory.mjs").MemoryArray} MemoryArray */

const BLOCK = 16; // triangles
const ROWS = 9; // of 16 numbers in a block
const BUNDLE = 0.01; // width of a bundle of rays, relative to the scene's diagonal
const FILLED_AT_A_TIME = 256; // blocks
const NO_BOX = 3e38;

/**
 * A tree of blocks: its arrays except links, and the extents of its box.
 * @typedef {{nodes: MemoryArray, blocks: MemoryArray, bounds: MemoryArray, slots: MemoryArray, ids: MemoryArray,
 *   corners: MemoryArray, extents: number[]}} BlockTree
 */

/**
 * The block tree of a BVH.
 * @param {KernelInstance} kernels
 * @param {import("./tree.mjs").Bvh} bvh
 * @returns {BlockTree}
 */
export function buildBlocks(kernels, [source, sourceLinks, ids, corners]) {
  const { arena } = kernels;
  const count = source.shape[0];
  const all = arena.array("f4", [count, 16]); // more nodes than are used
  const roots = arena.array("i4", [count + 1]);
  const [n, blockCount] = arena.scratch(() => {
    const [order, below] = [arena.array("i4", [count]), arena.array("i4", [count])];
    const m = kernels.call("antumbra.bvh.nodes:write_parents_first", sourceLinks, 0, order);
    kernels.call("antumbra.bvh.block_tree:_count_below", sourceLinks, order.rows(m), below);
    const args = [source, sourceLinks, below, BLOCK, all, all.as("i4", all.shape), roots];
    return kernels.call("antumbra.bvh.block_tree:_collapse", ...args);
  });
  const nodes = all.rows(n);
  const links = nodes.as("i4", nodes.shape);
  const blocks = arena.array("f4", [blockCount, ROWS, BLOCK]);
  const bounds = arena.array("f4", [blockCount, 8]);
  const slots = arena.array("i4", [blockCount, BLOCK]);
  const extents = extentsOf(nodes);
  arena.scratch(() => {
    const areas = arena.array("f8", [blockCount]);
    const filled = [roots.rows(blockCount), blocks, bounds, slots, areas];
    const fill = "antumbra.bvh.block_tree:_fill_blocks";
    kernels.run(fill, blockCount, FILLED_AT_A_TIME, sourceLinks, corners, ...filled);
    const order = arena.array("i4", [n]);
    const m = kernels.call("antumbra.bvh.nodes:write_parents_first", links, 0, order);
    const scratch = [arena.array("f8", [n]), arena.array("f8", [n])];
    const args = [nodes, links, order.rows(m), BUNDLE * Math.hypot(...extents), areas, ...scratch];
    kernels.call("antumbra.bvh.child_order:_order_for_bundles", ...args);
  });
  return { nodes, blocks, bounds, slots, ids, corners, extents };
}

/** The extents of a tree, of the boxes around its root's children. @param {MemoryArray} nodes */
function extentsOf(nodes) {
  const root = nodes.view.slice(0, 12);
  return [0, 4, 8].map((at) => Math.max(root[at + 2], root[at + 3]) - Math.min(root[at], root[at + 1]));
}

/**
 * The arguments of a `TreeList` of a single tree, for all points.
 * @param {KernelInstance} kernels
 * @param {BlockTree} tree
 */
export function treeList({ arena }, tree) {
  const addresses = [tree.nodes, tree.blocks, tree.bounds, tree.slots, tree.ids, tree.corners].map((each) =>
    BigInt(each.address),
  );
  const trees = arena.array("i8", [1, 7], [...addresses, 0n]);
  const head = arena.array("f4", [1, 16]);
  for (const axis of [0, 4, 8]) head.view.set([-NO_BOX, -NO_BOX, NO_BOX, NO_BOX], axis);
  const [starts, items] = [arena.array("i4", [2], [0, 1]), arena.array("i4", [1])];
  return [trees, head, 0, 1, 1, starts, items, true, arena.array("u1", [1])];
}
