// @ts-check
/** Exact ray queries on triangles: which rays are blocked, and what they hit first. The bits are those of Antumbra in Python. */

export { loadKernels, Scene } from "./scene.mjs";
