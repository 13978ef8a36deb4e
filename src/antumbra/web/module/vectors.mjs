// @ts-check
/** Vectors of three numbers, with the bits of their counterparts in Python. */

/** @typedef {ArrayLike<number>} Vector three numbers */

/**
 * A vector at unit length, also where its square overflows.
 * @param {Vector} v
 * @param {string} what names it in errors
 */
export function unit(v, what) {
  const largest = Math.max(Math.abs(v[0]), Math.abs(v[1]), Math.abs(v[2]));
  if (!Number.isFinite(largest)) throw new RangeError(`${what} has NaN or infinity; give it a direction`);
  if (largest === 0) throw new RangeError(`${what} is zero; give it a direction`);
  return unitOf(v, largest);
}

/**
 * A finite vector whose largest component is nonzero, at unit length.
 * @param {Vector} v
 * @param {number} largest
 */
export function unitOf(v, largest) {
  let [x, y, z] = [v[0], v[1], v[2]];
  for (let k = exponentOf(largest); k !== 0; ) {
    const step = Math.max(-1000, Math.min(1000, -k)); // a power of two, which does not change the result
    [x, y, z] = [x * 2 ** step, y * 2 ** step, z * 2 ** step];
    k += step;
  }
  const length = Math.sqrt(x * x + y * y + z * z);
  return [x / length, y / length, z / length];
}

/**
 * The exponent of a positive number as of frexp: the number is below 2 ** exponent, and at least half of it.
 * @param {number} x
 */
export function exponentOf(x) {
  let exponent = Math.min(1023, Math.max(-1022, Math.floor(Math.log2(x)))); // nearly
  while (x >= 2 ** exponent && exponent < 1024) exponent++;
  while (exponent > -1073 && x < 2 ** (exponent - 1)) exponent--;
  return exponent;
}

/** @param {Vector} a @param {Vector} b */
export function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/** @param {Vector} a @param {Vector} b */
export function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/**
 * Two unit vectors perpendicular to a unit vector and to each other [Duff et al. 2017].
 * @param {Vector} n
 */
export function tangents(n) {
  const s = n[2] < 0 || Object.is(n[2], -0) ? -1 : 1;
  const a = -1 / (s + n[2]);
  const b = n[0] * n[1] * a;
  return [
    [1 + s * n[0] * n[0] * a, s * b, -s * n[0]],
    [b, s + n[1] * n[1] * a, -n[1]],
  ];
}

/** Three finite numbers. @param {any} value @param {string} what */
export function vector(value, what) {
  const numbers = [0, 1, 2].map((k) => value?.[k]);
  if (value?.length !== 3 || !numbers.every(Number.isFinite))
    throw new RangeError(`${what} is ${value}; it must be three finite numbers`);
  return numbers;
}
