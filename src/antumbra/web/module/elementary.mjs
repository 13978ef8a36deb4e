// @ts-check
/** Sines, cosines and tangents with the bits of `antumbra.kernels.elementary`: the polynomials of fdlibm. */

const PER_QUADRANT = 0.6366197723675814; // 2 / pi
// pi/2 in parts of 33 bits
const [Q1, Q2, Q3, Q4] = [1.5707963267341256, 6.077100506303966e-11, 2.0222662487111665e-21, 8.4784276603689e-32];
const TO_WHOLE = 1.5 * 2 ** 52; // a sum with it is rounded to a whole number, halves to even

/**
 * The nearest whole number, the even one of two.
 * @param {number} x of magnitude below 2 ** 51
 */
export function toWhole(x) {
  return x + TO_WHOLE - TO_WHOLE;
}

/**
 * The sine and the cosine of an angle.
 * @param {number} x radians, of magnitude up to 2 ** 20
 */
export function sinCos(x) {
  const k = toWhole(x * PER_QUADRANT);
  const a = x - k * Q1;
  const b = a - k * Q2;
  let low = a - b - k * Q2;
  const c = b - k * Q3;
  low += b - c - k * Q3 - k * Q4;
  const r = c + low;
  low = c - r + low;
  const quarter = k - 4 * Math.floor(0.25 * k);
  const pair = quarter % 2 === 1 ? [cosine(r, low), sine(r, low)] : [sine(r, low), cosine(r, low)];
  const s = Math.abs(x) < 2 ** -27 ? x : quarter >= 2 ? -pair[0] : pair[0];
  return [s, quarter === 1 || quarter === 2 ? -pair[1] : pair[1]];
}

/**
 * @param {number} x radians
 */
export function tan(x) {
  const [s, c] = sinCos(x);
  return s / c;
}

/** Of r + low, |r| <= pi/4. @param {number} r @param {number} low */
function sine(r, low) {
  const z = r * r;
  let p = 2.7557313707070068e-6 + z * (-2.5050760253406863e-8 + z * 1.58969099521155e-10);
  p = 0.00833333333332249 + z * (-0.0001984126982985795 + z * p);
  return r - (z * (0.5 * low - z * r * p) - low + z * r * 0.16666666666666632);
}

/** Of r + low, |r| <= pi/4. @param {number} r @param {number} low */
function cosine(r, low) {
  const z = r * r;
  let p = -2.7557314351390663e-7 + z * (2.087572321298175e-9 - z * 1.1359647557788195e-11);
  p = -0.001388888888887411 + z * (2.480158728947673e-5 + z * p);
  p = z * (0.0416666666666666 + z * p);
  const half = 0.5 * z;
  const w = 1 - half;
  return w + (1 - w - half + (z * p - r * low));
}
