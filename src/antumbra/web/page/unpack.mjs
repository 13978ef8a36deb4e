// @ts-check
/** The scene in the page: compressed columns of numbers, which `page_export.py` packs. */

const LETTERS = 1 << 18; // of base64 that are decoded at a time; a multiple of 4
const PAUSE = 30; // milliseconds after which the browser may draw the progress bar

/** @typedef {{name: string, type: "f4" | "f8" | "i4" | "i2" | "u1", length: number, step: boolean}} Column */

const TYPES = { f4: Float32Array, f8: Float64Array, i4: Int32Array, i2: Int16Array, u1: Uint8Array };

/**
 * Decode columns.
 * @param {string} text base64 of a zlib stream
 * @param {Column[]} columns
 * @param {(share: number) => void} progress
 * @param {(bytes: Uint8Array<ArrayBuffer>) => void} seen called with all bytes, before they are arrays
 * @returns {Promise<Record<string, any>>} arrays by name
 */
export async function unpack(text, columns, progress, seen = () => {}) {
  const size = columns.reduce((sum, { type, length }) => sum + length * TYPES[type].BYTES_PER_ELEMENT, 0);
  const bytes = new Uint8Array(size);
  const stream = new DecompressionStream("deflate");
  const reading = collect(stream.readable, bytes);
  reading.catch(() => {}); // writing fails, too
  const writer = stream.writable.getWriter();
  let last = performance.now();
  for (let at = 0; at < text.length; at += LETTERS) {
    await writer.write(fromBase64(text.slice(at, at + LETTERS)));
    if (performance.now() - last < PAUSE) continue;
    progress((0.8 * at) / text.length);
    await pause();
    last = performance.now();
  }
  await writer.close();
  await reading;
  seen(bytes);
  /** @type {Record<string, any>} */
  const arrays = {};
  let at = 0;
  for (const [k, column] of columns.entries()) {
    arrays[column.name] = arrayOf(column, bytes, at);
    at += column.length * TYPES[column.type].BYTES_PER_ELEMENT;
    progress(0.8 + (0.2 * (k + 1)) / columns.length);
    await pause();
  }
  return arrays;
}

/** Let the browser draw. */
export function pause() {
  return new Promise((done) => setTimeout(done, 0));
}

/** @param {string} text */
function fromBase64(text) {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

/**
 * @param {ReadableStream<Uint8Array>} stream
 * @param {Uint8Array} bytes
 */
async function collect(stream, bytes) {
  const reader = stream.getReader();
  for (let at = 0; ; ) {
    const { done, value } = await reader.read();
    if (done && at === bytes.length) return;
    if (done || at + value.length > bytes.length) throw new Error("the columns have another size");
    bytes.set(value, at);
    at += value.length;
  }
}

/**
 * A column: byte 0 of all its numbers, then byte 1, and so on; as differences between neighbours if it has a step.
 * @param {Column} column
 * @param {Uint8Array} bytes
 * @param {number} start
 */
function arrayOf({ type, length, step }, bytes, start) {
  const array = new TYPES[type](length);
  const own = new Uint8Array(array.buffer);
  const width = array.BYTES_PER_ELEMENT;
  for (let k = 0; k < width; k++) {
    const plane = start + k * length;
    for (let i = 0, to = k; i < length; i++, to += width) own[to] = bytes[plane + i];
  }
  if (step) for (let i = 1; i < length; i++) array[i] += array[i - 1];
  return array;
}
