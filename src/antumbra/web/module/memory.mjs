// @ts-check
/** Arrays in the memory of a WebAssembly instance, which kernels read and write. */

const PAGE = 65536;
const ALIGNMENT = 64; // a cache line; kernels load vectors from whole lines

/** @typedef {Float32Array | Float64Array | Int32Array | Uint8Array | BigInt64Array} NumberArray */

/** Element types by the names that kernels' keys have for them. */
const TYPES = {
  f4: Float32Array,
  f8: Float64Array,
  i1: Int8Array,
  i4: Int32Array,
  i8: BigInt64Array,
  u1: Uint8Array,
  u8: BigUint64Array,
  b1: Uint8Array,
};

/** @typedef {keyof typeof TYPES} ElementType */

/** An array of any number of dimensions, in C order. */
export class MemoryArray {
  /**
   * @param {WebAssembly.Memory} memory
   * @param {ElementType} type
   * @param {number[]} shape
   * @param {number} address in bytes
   */
  constructor(memory, type, shape, address) {
    this.memory = memory;
    this.type = type;
    this.shape = shape;
    this.address = address;
    this.itemsize = TYPES[type].BYTES_PER_ELEMENT;
    this.length = shape.reduce((size, each) => size * each, 1);
  }

  /** The elements. Ask for them anew after other arrays were made: memory that grows moves. */
  get view() {
    return /** @type {any} */ (new TYPES[this.type](this.memory.buffer, this.address, this.length));
  }

  /**
   * The same memory as elements of another type and shape.
   * @param {ElementType} type
   * @param {number[]} shape
   */
  as(type, shape) {
    return new MemoryArray(this.memory, type, shape, this.address);
  }

  /**
   * The first rows.
   * @param {number} n
   */
  rows(n) {
    return new MemoryArray(this.memory, this.type, [n, ...this.shape.slice(1)], this.address);
  }
}

/** Memory that is handed out from the bottom, and given back from the top. */
export class Arena {
  /**
   * @param {WebAssembly.Memory} memory
   * @param {number} start the first free byte
   */
  constructor(memory, start) {
    this.memory = memory;
    this.top = start;
  }

  /**
   * An array of zeros, or with the values of another one.
   * @param {ElementType} type
   * @param {number[]} shape
   * @param {ArrayLike<any>} [values]
   */
  array(type, shape, values) {
    const address = Math.ceil(this.top / ALIGNMENT) * ALIGNMENT;
    const made = new MemoryArray(this.memory, type, shape, address);
    this.top = address + Math.max(made.length * made.itemsize, 1);
    const missing = this.top + ALIGNMENT - this.memory.buffer.byteLength; // kernels may read past the end of a row
    if (missing > 0) this.#grow(Math.ceil(missing / PAGE));
    if (values) made.view.set(values);
    else new Uint8Array(this.memory.buffer, address, made.length * made.itemsize).fill(0);
    return made;
  }

  /** @param {number} pages */
  #grow(pages) {
    try {
      this.memory.grow(pages);
    } catch {
      throw new RangeError(
        `the scene and its rays need ${Math.ceil(this.top / 2 ** 20)} MiB, and WebAssembly has no more; ` +
          "trace fewer rays a call, or a smaller scene",
      );
    }
  }

  /**
   * Call a function, and give the memory back that it took.
   * @template T
   * @param {() => T} work
   * @returns {T}
   */
  scratch(work) {
    const top = this.top;
    try {
      return work();
    } finally {
      this.top = top;
    }
  }
}
