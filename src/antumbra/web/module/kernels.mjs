// @ts-check
/** Kernels of Antumbra in WebAssembly: calls with numbers, booleans, null, arrays in memory, and lists of these. */

import { Arena, MemoryArray } from "./memory.mjs";
import { CAN_SHARE, CONTROL_WORDS, Helpers, withSharedMemory } from "./threads.mjs";

const FIRST_PAGES = 128; // the stack and constants, and a small scene
const MOST_PAGES = 65536; // what 32-bit addresses reach
const RESULT_WORDS = 64;
const STACK = 4 << 20; // bytes of a thread's stack, as the module was linked with

/**
 * A kernel for certain kinds of arguments.
 * @typedef {{symbol: string, tokens: string[], result: any}} Kernel
 */

/** The compiled module, and its kernels by name. One for all scenes. */
export class KernelModule {
  /**
   * @param {WebAssembly.Module} module
   * @param {{kernels: Record<string, [string, any]>}} list `kernels.json`, which is built with the module
   */
  constructor(module, list) {
    this.module = module;
    /** @type {Map<string, Kernel[]>} */
    this.kernels = new Map();
    for (const [name, [symbol, result]] of Object.entries(list.kernels)) {
      const [kernel, ...tokens] = name.split(" ").filter((token) => token !== ")" && !/[^[]\($|^\($/.test(token));
      const named = this.kernels.get(kernel) ?? [];
      named.push({ symbol, tokens, result });
      this.kernels.set(kernel, named);
    }
  }

  /**
   * @param {Uint8Array} bytes of the module
   * @param {any} list
   */
  static async compile(bytes, list) {
    return new KernelModule(
      await WebAssembly.compile(CAN_SHARE ? withSharedMemory(bytes) : new Uint8Array(bytes)),
      list,
    );
  }

  /** @param {number} threads that work on a call; more than one where they can share memory */
  async instance(threads) {
    const made = new KernelInstance(this);
    const extra = CAN_SHARE ? threads - 1 : 0;
    for (let k = 0; k < extra; k++) await made.addThread(this.module);
    return made;
  }
}

/** An instance of the module with memory of its own. */
export class KernelInstance {
  /** @param {KernelModule} module */
  constructor({ module, kernels }) {
    this.kernels = kernels;
    this.memory = new WebAssembly.Memory({ initial: FIRST_PAGES, maximum: MOST_PAGES, shared: CAN_SHARE });
    this.exports = /** @type {Record<string, any>} */ (
      new WebAssembly.Instance(module, { env: { memory: this.memory } }).exports
    );
    this.arena = new Arena(this.memory, this.exports.__heap_base.value);
    this.results = this.arena.array("i8", [RESULT_WORDS]);
    this.control = this.arena.array("i4", [CONTROL_WORDS]);
    const names = WebAssembly.Module.exports(module).map(({ name }) => name);
    this.helpers = new Helpers(this.memory, this.control.address, names);
  }

  /** @param {WebAssembly.Module} module */
  async addThread(module) {
    const stack = this.arena.array("u1", [STACK]).address + STACK;
    const results = this.arena.array("i8", [RESULT_WORDS]).address;
    await this.helpers.add({ module, memory: this.memory, stack, results, control: this.control.address });
  }

  /**
   * Call a kernel, and return its result: a number, a list of numbers, or null.
   * @param {string} name such as "antumbra.bvh.lbvh:_depth"
   * @param {any[]} args
   */
  call(name, ...args) {
    return this.#call(name, args, false);
  }

  /**
   * @param {string} name
   * @param {any[]} args
   * @param {boolean} together whether other threads make the same call
   */
  #call(name, args, together) {
    const values = args.flat(Infinity);
    const found = (this.kernels.get(name) ?? []).find((kernel) => fits(kernel.tokens, values));
    if (!found) throw new TypeError(`the module has no kernel ${name} for these arguments`);
    return this.arena.scratch(() => {
      const words = this.arena.array("i8", [values.reduce((n, each) => n + wordsOf(each), 1)]);
      write(new DataView(this.memory.buffer, words.address), found.tokens, values);
      const own = () => this.exports[found.symbol](words.address, this.results.address);
      const status = together ? this.helpers.run(found.symbol, words.address, own) : own();
      if (status !== 0n) throw new Error(`${name}: error ${status} in compiled code`);
      return read(new DataView(this.memory.buffer, this.results.address), found.result, { at: 0 });
    });
  }

  /**
   * Call a worker, a kernel that takes its items from a ticket, for n items, in all threads.
   * @param {string} name
   * @param {number} n
   * @param {number} chunk items that it takes at a time
   * @param {any[]} args
   */
  run(name, n, chunk, ...args) {
    this.arena.scratch(() =>
      this.#call(name, [this.ticket(n, chunk), ...args], n > chunk && this.helpers.workers.length > 0),
    );
  }

  /**
   * `antumbra.kernels.parallel.new_ticket`.
   * @param {number} n
   * @param {number} chunk
   */
  ticket(n, chunk) {
    return this.arena.array("i8", [5], [0n, 0n, BigInt(n), BigInt(chunk), 0n]);
  }
}

/** @param {any} value */
function wordsOf(value) {
  return value instanceof MemoryArray ? 1 + 2 * value.shape.length : value === null ? 0 : 1;
}

/**
 * Whether values are of the kinds that a kernel takes.
 * @param {string[]} tokens
 * @param {any[]} values
 */
function fits(tokens, values) {
  return (
    tokens.length === values.length &&
    tokens.every((token, k) => {
      const value = values[k];
      if (token[1] === "[") {
        const [type, dimensions] = token.slice(2, -1).split(",");
        return value instanceof MemoryArray && value.type === type && value.shape.length === Number(dimensions);
      }
      if (token === "n") return value === null;
      return token === "b" ? typeof value === "boolean" : typeof value === "number";
    })
  );
}

/**
 * Write arguments as 8-byte words.
 * @param {DataView} words
 * @param {string[]} tokens
 * @param {any[]} values
 */
function write(words, tokens, values) {
  let at = 0;
  const integer = (/** @type {number} */ value) => {
    words.setBigInt64(at, BigInt(value), true);
    at += 8;
  };
  tokens.forEach((token, k) => {
    const value = values[k];
    if (value instanceof MemoryArray) {
      integer(value.address);
      value.shape.forEach(integer);
      let stride = value.itemsize;
      const strides = value.shape.map(() => 0);
      for (let axis = value.shape.length - 1; axis >= 0; axis--) {
        strides[axis] = stride;
        stride *= value.shape[axis];
      }
      strides.forEach(integer);
    } else if (token === "d") {
      words.setFloat64(at, value, true);
      at += 8;
    } else if (token === "f") {
      words.setFloat32(at, value, true);
      at += 8;
    } else if (value !== null) integer(Number(value));
  });
}

/**
 * A kernel's result from the words that it wrote.
 * @param {DataView} words
 * @param {any} spec
 * @param {{at: number}} place
 * @returns {any}
 */
function read(words, spec, place) {
  if (Array.isArray(spec)) return spec[1].map((/** @type {any} */ item) => read(words, item, place));
  if (spec === "n") return null;
  const at = place.at;
  place.at += 8;
  if (spec === "d") return words.getFloat64(at, true);
  if (spec === "f") return words.getFloat32(at, true);
  if (spec === "b") return words.getUint8(at) !== 0;
  return Number(words.getBigInt64(at, true));
}
