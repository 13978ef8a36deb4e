// @ts-check
/** Textures: images decoded by the browser, and their mip levels as `antumbra.scene.materials` has them. */

/**
 * An image as rows of four bytes, and all smaller levels one after the other. Wraps: 0 repeats, 1 clamps, 2 mirrors.
 * @typedef {{width: number, height: number, pixels: Uint8Array, mips: Uint8Array, wraps: number[], nearest: boolean}} Texture
 */

/** @typedef {{type: string, wraps: number[], nearest: boolean, column: string}} Listed as `page_look.py` lists it */

/** Linear light of sRGB bytes. */
export const LINEAR = Float32Array.from({ length: 256 }, (_, byte) => {
  const s = byte / 255;
  return s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4;
});

const f = Math.fround;
const STEPS = 1 << 16; // entries of the table from linear light to bytes

/** @type {Uint8Array | null} */ let bytes = null;

/** The nearest sRGB byte of linear light. */
function toByte() {
  if (bytes) return bytes;
  bytes = new Uint8Array(STEPS);
  let byte = 0;
  for (let k = 0; k < STEPS; k++) {
    while (byte < 255 && k / (STEPS - 1) > (LINEAR[byte] + LINEAR[byte + 1]) / 2) byte++;
    bytes[k] = byte;
  }
  return bytes;
}

/**
 * Decode textures, one after the other.
 * @param {Listed[]} listed
 * @param {Record<string, any>} arrays
 * @param {(share: number) => void} progress
 * @returns {Promise<Texture[]>}
 */
export async function decodeTextures(listed, arrays, progress) {
  const textures = [];
  for (const [k, { type, wraps, nearest, column }] of listed.entries()) {
    const blob = new Blob([arrays[column]], { type });
    const image = await createImageBitmap(blob, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
    const { width, height } = image;
    const context = /** @type {OffscreenCanvasRenderingContext2D} */ (
      new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true })
    );
    context.drawImage(image, 0, 0);
    image.close();
    const pixels = new Uint8Array(context.getImageData(0, 0, width, height).data.buffer);
    textures.push({ width, height, pixels, mips: mipLevels(pixels, width, height), wraps, nearest });
    progress((k + 1) / listed.length);
  }
  return textures;
}

/**
 * The smaller levels of an image: means in linear light, down to one texel.
 * @param {Uint8Array} pixels
 * @param {number} width
 * @param {number} height
 */
export function mipLevels(pixels, width, height) {
  /** @type {Float32Array} */
  let level = new Float32Array(pixels.length);
  for (let k = 0; k < level.length; k++) level[k] = k % 4 === 3 ? pixels[k] / 255 : LINEAR[pixels[k]];
  const parts = [];
  for (let [w, h] = [width, height]; w > 1 || h > 1; ) {
    level = halved(halved(level, h, 4 * w, 1), w, 4, Math.max(1, h >> 1));
    [w, h] = [Math.max(1, w >> 1), Math.max(1, h >> 1)];
    parts.push(bytesOf(level));
  }
  const out = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}

/**
 * Half of n entries of `size` numbers, in each of several runs: means of pairs; for an odd number 2 k + 1, k means over
 * 2 + 1 / k entries.
 * @param {Float32Array} values
 * @param {number} n
 * @param {number} size
 * @param {number} runs
 */
function halved(values, n, size, runs) {
  if (n === 1) return values;
  const k = n >> 1;
  const out = new Float32Array(runs * k * size);
  const odd = n % 2 === 1;
  for (let run = 0; run < runs; run++)
    for (let i = 0; i < k; i++) {
      const from = (run * n + 2 * i) * size;
      const to = (run * k + i) * size;
      for (let j = 0; j < size; j++) {
        const [a, b] = [values[from + j], values[from + size + j]];
        out[to + j] = odd
          ? f(f(f(f((k - i) * a) + f(k * b)) + f((i + 1) * values[from + 2 * size + j])) * f(1 / n))
          : (a + b) / 2;
      }
    }
  return out;
}

/** @param {Float32Array} linear */
function bytesOf(linear) {
  const table = toByte();
  const out = new Uint8Array(linear.length);
  for (let k = 0; k < out.length; k++)
    out[k] = k % 4 === 3 ? f(f(255 * linear[k]) + 0.5) : table[Math.floor(f(f(linear[k] * (STEPS - 1)) + 0.5))];
  return out;
}
