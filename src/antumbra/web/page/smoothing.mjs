// @ts-check
/** The mean over 4 x 4 pixels of a surface, by the kernels of `antumbra.picture.discontinuity_filter`. */

/** @typedef {import("../module/memory.mjs").MemoryArray} MemoryArray */
/** @typedef {import("../module/kernels.mjs").KernelInstance} KernelInstance */

export const REACH = 2; // pixels from a pixel to the end of its window
const [ROWS, MARGIN, LANES] = [8, 16, 8]; // of a share, elements beside rows, and vectors
const ALL_LINKS = (1 << 12) - 1;

/**
 * The arguments of `SurfaceLinks`: which pixels see the same surface as their neighbours.
 * @param {KernelInstance} kernels
 * @param {any} surfaces
 * @param {number} pixel width of a pixel at depth 1
 */
export function linksOf(kernels, { position, normal, face, depth, side }, pixel) {
  const { arena } = kernels;
  const [h, w] = face.shape;
  const pad = REACH * w + MARGIN;
  const plane = (ROWS + REACH) * (w + MARGIN);
  const links = [arena.array("i4", [h * w + 2 * pad]), pad, h, w];
  const scratch = arena.array("f4", [8 * plane + w + MARGIN + (ROWS + REACH) * ((w + 7) >> 3)]);
  const pixels = [position, normal, face, depth, side, pixel];
  kernels.run("antumbra.query.surface_links:_link_rows", h, ROWS, pixels, ALL_LINKS, links, scratch);
  return links;
}

/**
 * Smooth irradiance in place.
 * @param {KernelInstance} kernels
 * @param {any[]} links
 * @param {MemoryArray} irradiance (h, w, 3)
 */
export function smooth(kernels, links, irradiance) {
  const { arena } = kernels;
  const [h, w] = irradiance.shape;
  const source = arena.array("f4", irradiance.shape);
  const scratch = arena.array("f4", [6 * ((ROWS + 2 * REACH) * w + 2 * LANES)]);
  source.view.set(irradiance.view);
  kernels.run("antumbra.picture.discontinuity_filter:_smooth_rows", h, ROWS, links, source, irradiance, scratch);
}
