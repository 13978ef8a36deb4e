// @ts-check
/** The first module of a thread: waits for what it starts with, and serves jobs. */

import { IN_NODE, serve } from "./threads.mjs";

if (IN_NODE) {
  const { parentPort } = await import(/** @type {string} */ ("node:worker_threads"));
  parentPort.once("message", serve);
} else globalThis.onmessage = ({ data }) => serve(data);
