// @ts-check
/** From linear light to the screen, as `antumbra.picture.image_files` and `sky_background` have it. */

const [PERCENTILE, BRIGHT, MIDDLE, MOST_BRIGHTER, WIDE, WIDE_AT_MOST] = [97, 0.75, 0.4, 3, 85, 0.75];
const [SHOULDER, TOP, ENTRIES] = [0.6, 4, 1 << 16];
const EXPOSURE_PIXELS = 1 << 18; // that the exposure samples, about
const [BACKDROP, BRIGHTEST] = [0.75, 0.9];
const [ZENITH, HORIZON, GROUND] = [
  [0.46, 0.63, 0.92],
  [0.92, 0.94, 0.97],
  [0.6, 0.59, 0.57],
]; // of antumbra.scene.sky
const ROWS = 64;
const DAYLIGHT = Array.from({ length: ROWS }, (_, row) => skyLight(Math.cos((Math.PI * (row + 0.5)) / ROWS)));

/** Bytes of linear light up to TOP: of pictures, with rolled-off highlights; and of colours as they are. */
const [CURVE, PLAIN] = [rollOff, (/** @type {number} */ x) => Math.min(1, x)].map((tone) =>
  Uint8Array.from({ length: ENTRIES }, (_, entry) => Math.round(255 * toSrgb(tone(((entry + 0.5) * TOP) / ENTRIES)))),
);

/** @param {number} x linear light */
function rollOff(x) {
  return x <= SHOULDER ? x : 1 - (1 - SHOULDER) * Math.exp((SHOULDER - x) / (1 - SHOULDER));
}

/** @param {number} x linear, in [0, 1] */
function toSrgb(x) {
  return x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055;
}

/**
 * The exposure that makes a picture bright but not clipped; 1 without light.
 * @param {Float32Array} light of a pass: red, green, blue and coverage
 */
export function exposureOf(light) {
  const step = Math.max(1, Math.floor(light.length / 4 / EXPOSURE_PIXELS));
  const values = new Float32Array(Math.ceil(light.length / 4 / step));
  let n = 0;
  for (let i = 0; i < light.length; i += 4 * step) {
    const luminance = 0.2126 * light[i] + 0.7152 * light[i + 1] + 0.0722 * light[i + 2];
    if (light[i + 3] > 0 && luminance > 0 && luminance < Infinity) values[n++] = luminance;
  }
  if (n === 0) return 1;
  const ordered = values.subarray(0, n).sort();
  const [middle, wide, high] = [50, WIDE, PERCENTILE].map((percent) => {
    const at = (percent / 100) * (n - 1);
    const [low, up] = [ordered[Math.floor(at)], ordered[Math.min(n - 1, Math.floor(at) + 1)]];
    return Math.max(low + (up - low) * (at - Math.floor(at)), 1e-30);
  });
  const exposure = BRIGHT / high;
  const brighter = Math.min(MIDDLE / (middle * exposure), WIDE_AT_MOST / (wide * exposure), MOST_BRIGHTER);
  return exposure * Math.max(1, brighter);
}

/**
 * Red, green, blue and alpha of pixels.
 * @param {Float32Array} sum of the light and coverage of passes
 * @param {number} passes
 * @param {number | null} exposure null: surfaces have the colours of the screen
 * @param {Float32Array | null} behind linear shares of white behind the scene; null: the light has the sky
 * @param {number} dim factor of these shares
 * @param {number} sky what the light has of them, which they replace, as a multiple
 */
export function toScreen(sum, passes, exposure, behind, dim, sky = 0) {
  const out = new Uint8ClampedArray(sum.length);
  const [curve, scale] = [exposure === null ? PLAIN : CURVE, ((exposure ?? 1) * ENTRIES) / TOP];
  for (let i = 0; i < sum.length; i += 4) {
    const share = behind ? sum[i + 3] / passes : 1;
    const factor = share > 0 ? scale / (passes * share) : 0;
    for (let c = 0; c < 3; c++) {
      const light = sky ? sum[i + c] - (passes - sum[i + 3]) * sky * (behind?.[(i / 4) * 3 + c] ?? 0) : sum[i + c];
      const byte = curve[Math.min(ENTRIES - 1, Math.max(0, light * factor)) | 0];
      out[i + c] = share === 1 || !behind ? byte : mixed(byte, share, behind[(i / 4) * 3 + c] * dim);
    }
    out[i + 3] = 255;
  }
  return out;
}

/**
 * A byte that surfaces cover in part, mixed with the background in linear light.
 * @param {number} byte
 * @param {number} share
 * @param {number} behind
 */
function mixed(byte, share, behind) {
  const s = byte / 255;
  const linear = s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4;
  return Math.round(255 * toSrgb(Math.min(1, share * linear + (1 - share) * behind)));
}

/**
 * How a soft daylight that the light has is shown where an exposure turns it white: `dim` and `sky` of `toScreen`; else
 * null.
 * @param {number} exposure
 * @param {number} radiance of the daylight; 0: the light has another sky, or none
 */
export function dimmed(exposure, radiance) {
  return exposure * radiance > BRIGHTEST ? { dim: BRIGHTEST / BACKDROP, sky: radiance / BACKDROP } : null;
}

/**
 * Soft daylight behind a scene, three numbers a pixel.
 * @param {import("./frame.mjs").Rays} rays
 * @param {number} width
 * @param {number} height
 * @param {number} up axis
 */
export function backdrop({ corner, dx, dy }, width, height, up) {
  const out = new Float32Array(3 * width * height);
  for (let i = 0; i < width * height; i++) {
    const [x, y] = [(i % width) + 0.5, Math.floor(i / width) + 0.5];
    const way = [0, 1, 2].map((k) => corner[k] + x * dx[k] + y * dy[k]);
    const light = mapped(way[up] / Math.hypot(way[0], way[1], way[2]));
    for (let k = 0; k < 3; k++) out[3 * i + k] = BACKDROP * light[k];
  }
  return out;
}

/**
 * The radiance of soft daylight, interpolated between the rows of a map as `Sky` does it.
 * @param {number} height sine of the elevation
 */
function mapped(height) {
  const down = Math.acos(Math.max(-1, Math.min(1, height))) * (ROWS / Math.PI) - 0.5;
  const row = Math.floor(down);
  const [above, below] = [DAYLIGHT[Math.max(0, row)], DAYLIGHT[Math.min(ROWS - 1, row + 1)]];
  return above.map((light, k) => light + (down - row) * (below[k] - light));
}

/**
 * The radiance of soft daylight.
 * @param {number} height sine of the elevation
 */
function skyLight(height) {
  if (height >= 0) {
    const share = Math.min(height, 1) ** 0.6;
    return HORIZON.map((h, k) => h + (ZENITH[k] - h) * share);
  }
  const share = Math.min(-height / 0.35, 1);
  return HORIZON.map((h, k) => h + (GROUND[k] - h) * share * share * (3 - 2 * share));
}
