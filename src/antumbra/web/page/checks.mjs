// @ts-check
/** What the page checks: that the browser suits it, and that scene and bits are those of the program that wrote it. */

import { fill } from "./words.mjs";

/** @typedef {import("./words.mjs").Words} Words */

/** The smallest module with a vector of 128 bits, which the kernels use. */
const VECTORS = Uint8Array.of(
  ...[0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123], // a function that returns a vector
  ...[3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11],
);
const OF_MEMORY = /memory|allocation|invalid array (buffer )?length/i; // in the errors of the browsers

/** How the states of a scene end the names of their columns; the last state, or the only one, has names without end. */
const ENDS = ["Before", ""];

/** The first thing that the page needs and the browser lacks, or "". */
export function missing() {
  const needed = ["WebAssembly", "DecompressionStream", "OffscreenCanvas", "Worker"];
  const lack = needed.find((name) => !(name in globalThis));
  return lack ?? (WebAssembly.validate(VECTORS) ? "" : "WebAssembly SIMD");
}

/**
 * Why the page cannot go on.
 * @param {any} error
 * @param {Words} words
 * @param {number} triangles
 * @param {string} other what is said unless memory is short; default: the error's own message
 */
export function reasonOf(error, words, triangles, other = "") {
  const reason = String(error?.message ?? error);
  return OF_MEMORY.test(reason) ? fill(words.memory, { triangles: numberText(triangles) }) : other || reason;
}

/** @param {number} n */
export function numberText(n) {
  return n.toLocaleString(globalThis.document?.documentElement.lang);
}

/**
 * The recorded rays, and their answers in a state.
 * @param {Record<string, any>} arrays columns of `page_export.py`
 * @param {number} state counted from the last, which is -1
 */
export function recordOf(arrays, state) {
  const end = ENDS[ENDS.length + state];
  const [blocked, faces, distances] = ["blocked", "faces", "distances"].map((name) => arrays[name + end]);
  return { origins: arrays.origins, directions: arrays.directions, blocked, faces, distances };
}

/**
 * SHA-256 in hexadecimal; null where the browser has none.
 * @param {Uint8Array<ArrayBuffer>} bytes
 */
export async function digestOf(bytes) {
  const digest = await globalThis.crypto?.subtle?.digest("SHA-256", bytes).catch(() => null);
  return digest ? Array.from(new Uint8Array(digest), (byte) => byte.toString(16).padStart(2, "0")).join("") : null;
}

/**
 * The result of the proof in words.
 * @param {{wrong: number, n: number, version: string, digest: string | null, recorded: string}} found rays whose bits
 *   differ, all rays, and the digests of the scene here and as it was written
 * @param {Words} words
 */
export function verdictOf({ wrong, n, version, digest, recorded }, words) {
  const altered = digest !== null && digest !== recorded;
  const failed = [altered && words.altered, wrong > 0 && words.wrong].filter((phrase) => typeof phrase === "string");
  const phrases = failed.length > 0 ? failed : [digest === null ? words.provedRays : words.proved];
  return { ok: failed.length === 0, text: phrases.map((phrase) => fill(phrase, { wrong, n, version })).join(" ") };
}
