// @ts-check
/** The workers of the page, each with a scene and memory of its own, and the jobs that they take from a queue. */

import { QUESTIONS } from "./questions.mjs";
import { Tracer } from "./tracer.mjs";

const LARGE = 400_000; // triangles from which one worker has to do, for memory
const MOST_WORKERS = 6;

/** @typedef {"band" | "prove" | keyof QUESTIONS} Method */
/** @typedef {{method: Method, job: any, done: (answer: any) => void, failed: (reason: Error) => void}} Task */

/** Answer messages in a worker. The first one makes its scene in each of its states; a job without one is about the last. */
export function serve() {
  /** @type {Tracer[]} */
  const tracers = [];
  globalThis.onmessage = async ({ data: { method, job } }) => {
    try {
      if (method === "create") {
        for (const indices of job.states)
          tracers.push(await Tracer.create(job.wasm, job.kernels, { ...job.look, indices }));
        postMessage({});
        return;
      }
      const tracer = /** @type {Tracer} */ (tracers.at(job.state ?? -1));
      const answer =
        method in QUESTIONS
          ? QUESTIONS[method](tracer, job)
          : /** @type {any} */ (tracer[/** @type {"band" | "prove"} */ (method)](job));
      postMessage({ answer }, { transfer: answer?.light ? [answer.light.buffer] : [] });
    } catch (error) {
      postMessage({ error: String(/** @type {Error} */ (error).message ?? error) });
    }
  };
}

export class Pool {
  /** @type {Worker[]} */ #idle = [];
  /** @type {Task[]} */ #tasks = [];
  size = 1; // workers

  /**
   * Start workers; it returns when the first one is ready.
   * @param {string} source of the program
   * @param {any} scene wasm, kernels, look, and the indices in each state
   * @param {number} triangles
   * @param {(reason: Error) => void} failed
   */
  async start(source, scene, triangles, failed) {
    const url = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
    this.size = triangles > LARGE ? 1 : workerCount(navigator.hardwareConcurrency ?? 2);
    const started = Array.from({ length: this.size }, async () => {
      const worker = new Worker(url);
      await send(worker, "create", scene);
      this.#idle.push(worker);
      this.#next();
    });
    for (const each of started) each.catch(failed);
    await Promise.any(started).catch((error) => {
      throw error.errors[0];
    });
  }

  /**
   * Let the next idle worker do a job.
   * @param {Method} method
   * @param {any} job
   * @param {boolean} urgent before all others
   * @returns {Promise<any>}
   */
  run(method, job, urgent = false) {
    return new Promise((done, failed) => {
      const task = { method, job, done, failed };
      if (urgent) this.#tasks.unshift(task);
      else this.#tasks.push(task);
      this.#next();
    });
  }

  /**
   * Drop the jobs of a method that have not begun.
   * @param {Method} which
   * @param {number} [state] of the scene, as the jobs have it
   */
  drop(which, state) {
    const dropped = this.#tasks.filter(({ method, job }) => method === which && job.state === state);
    this.#tasks = this.#tasks.filter((task) => !dropped.includes(task));
    for (const { done } of dropped) done(null);
  }

  #next() {
    while (this.#idle.length > 0 && this.#tasks.length > 0) {
      const worker = /** @type {Worker} */ (this.#idle.pop());
      const { method, job, done, failed } = /** @type {Task} */ (this.#tasks.shift());
      send(worker, method, job)
        .then(done, failed)
        .finally(() => {
          this.#idle.push(worker);
          this.#next();
        });
    }
  }
}

/** The page itself needs a core only now and then. @param {number} cores */
function workerCount(cores) {
  return Math.max(1, Math.min(MOST_WORKERS, cores <= 2 ? cores : cores - 1));
}

/**
 * @param {Worker} worker
 * @param {string} method
 * @param {any} job
 * @returns {Promise<any>}
 */
function send(worker, method, job) {
  return new Promise((done, failed) => {
    worker.onmessage = ({ data: { answer, error } }) => (error ? failed(new Error(error)) : done(answer));
    worker.onerror = ({ message }) => failed(new Error(message || "a worker did not start"));
    worker.postMessage({ method, job });
  });
}
