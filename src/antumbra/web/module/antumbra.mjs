// @ts-check
/** Exact ray queries on triangles: which rays are blocked, what they hit first, and which lights points see. The bits are
 * those of Antumbra in Python. */

export { loadKernels, Scene } from "./scene.mjs";
export { sunPosition, sunsOf } from "./sun.mjs";
