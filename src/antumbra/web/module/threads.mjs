// @ts-check
/**
 * Threads that help with calls of kernels, over one shared memory. The caller works too and never sleeps, so calls stay
 * synchronous, also in a page's main thread. A thread that has not started yet is not waited for.
 */

/** Words of the control block, int32, that all threads share. */
const JOB = 0; // changes with each job
const OPEN = 1; // 1 while threads may begin the job
const BUSY = 2; // threads between their look at OPEN and their end
const FAILED = 3; // threads whose kernel trapped
const FUNCTION = 4; // place of the kernel among the module's exports, in their order
const ARGUMENTS = 5; // address of its arguments
const PAGES = 6; // of memory
const LENGTH = 7; // of the first failure's message, whose letters follow
const MESSAGE = 8;
const LETTERS = 200;
export const CONTROL_WORDS = MESSAGE + LETTERS;

const PAGE = 65536;

/** Whether this is node, not a browser. */
export const IN_NODE = Boolean(/** @type {any} */ (globalThis).process?.versions?.node);

/** Whether threads can share memory here: in node, and in pages that are isolated from others. */
export const CAN_SHARE =
  typeof SharedArrayBuffer !== "undefined" && (IN_NODE || Boolean(globalThis.crossOriginIsolated));

/** The number of threads that this machine runs at once. */
export function threadCount() {
  return globalThis.navigator?.hardwareConcurrency ?? 4;
}

/**
 * A module whose imported memory is shared, for `WebAssembly.compile`.
 * @param {Uint8Array} bytes of the module
 */
export function withSharedMemory(bytes) {
  const out = new Uint8Array(bytes);
  const number = (/** @type {{at: number}} */ place) => {
    let [value, shift, byte] = [0, 0, 0];
    do {
      byte = out[place.at++];
      value += (byte & 127) * 2 ** shift;
      shift += 7;
    } while (byte & 128);
    return value;
  };
  const place = { at: 8 }; // after the magic number and the version
  while (place.at < out.length) {
    const section = out[place.at++];
    const size = number(place);
    if (section === 2) {
      number(place); // of imports: the memory is the only one
      for (const _ of ["module", "name"]) {
        const length = number(place);
        place.at += length;
      }
      out[place.at + 1] = 3; // limits: with a maximum, shared
      return out;
    }
    place.at += size;
  }
  throw new Error("the module imports no memory");
}

/**
 * What a thread gets when it starts.
 * @typedef {{module: WebAssembly.Module, memory: WebAssembly.Memory, stack: number, results: number, control: number}} Start
 */

/** The threads that help one caller. */
export class Helpers {
  /** @param {WebAssembly.Memory} memory @param {number} control address of the control block @param {string[]} exports */
  constructor(memory, control, exports) {
    this.memory = memory;
    this.control = control;
    /** @type {Map<string, number>} */
    this.places = new Map(exports.map((name, place) => [name, place]));
    /** @type {any[]} */
    this.workers = [];
  }

  get #words() {
    return new Int32Array(this.memory.buffer, this.control, CONTROL_WORDS);
  }

  /**
   * Start a thread. It takes part in jobs as soon as it is ready.
   * @param {Start} start
   */
  async add(start) {
    const url = new URL("worker.mjs", import.meta.url);
    let worker;
    if (IN_NODE) {
      const threads = await import(/** @type {string} */ ("node:worker_threads"));
      worker = new threads.Worker(url);
      worker.unref(); // does not keep the process alive
    } else worker = new Worker(url, { type: "module" });
    worker.postMessage(start);
    this.workers.push(worker);
  }

  /**
   * Run a kernel in all threads that are ready, and in this one.
   * @param {string} symbol
   * @param {number} args address of its arguments, whose first one is a ticket
   * @param {() => bigint} own the same call
   */
  run(symbol, args, own) {
    const words = this.#words;
    words[FUNCTION] = /** @type {number} */ (this.places.get(symbol));
    words[ARGUMENTS] = args;
    words[PAGES] = this.memory.buffer.byteLength / PAGE;
    Atomics.store(words, FAILED, 0);
    Atomics.store(words, OPEN, 1);
    Atomics.add(words, JOB, 1);
    Atomics.notify(words, JOB);
    let status;
    try {
      status = own();
    } finally {
      Atomics.store(words, OPEN, 0);
      while (Atomics.load(words, BUSY) > 0); // the last items take microseconds
    }
    if (Atomics.load(words, FAILED) > 0) {
      const reason = String.fromCharCode(...words.subarray(MESSAGE, MESSAGE + words[LENGTH]));
      throw new Error(`${symbol}: a thread failed in compiled code: ${reason}`);
    }
    return status;
  }

  /** End all threads. */
  close() {
    for (const worker of this.workers) worker.terminate();
    this.workers = [];
  }
}

/**
 * Serve jobs, for ever.
 * @param {Start} start
 */
export function serve({ module, memory, stack, results, control }) {
  const instance = new WebAssembly.Instance(module, { env: { memory } });
  const exports = /** @type {Record<string, any>} */ (instance.exports);
  const functions = WebAssembly.Module.exports(module).map(({ name }) => exports[name]);
  exports.__stack_pointer.value = stack | 0;
  const words = new Int32Array(memory.buffer, control, CONTROL_WORDS);
  let pages = 0;
  for (;;) {
    const job = Atomics.load(words, JOB);
    Atomics.add(words, BUSY, 1);
    if (Atomics.load(words, OPEN) === 1) {
      try {
        if (words[PAGES] !== pages) memory.grow(0); // makes this thread see what another one has added
        pages = words[PAGES];
        functions[words[FUNCTION]](words[ARGUMENTS], results);
      } catch (error) {
        if (Atomics.add(words, FAILED, 1) === 0) tell(words, String(error));
      }
    }
    Atomics.sub(words, BUSY, 1);
    Atomics.wait(words, JOB, job);
  }
}

/**
 * Write why a kernel failed into the control block. The caller reads it when no thread is busy any more.
 * @param {Int32Array} words
 * @param {string} reason
 */
function tell(words, reason) {
  words[LENGTH] = Math.min(reason.length, LETTERS);
  for (let i = 0; i < words[LENGTH]; i++) words[MESSAGE + i] = reason.charCodeAt(i);
}
