// @ts-check
/**
 * The position of the sun, as `antumbra sun` has it: the largest terms of NREL's Solar Position Algorithm [Reda and
 * Andreas 2004], within 0.003 degrees of all of them from 1900 to 2199.
 */

/** @typedef {{altitude: number, azimuth: number}} Angles degrees above the horizon, and clockwise from true north */

/** Amplitude in 1e-8 radians, phase and frequency per millennium, for each power of time. */
const LONGITUDE = [
  [
    [175347046, 0, 0],
    [3341656, 4.6692568, 6283.07585],
    [34894, 4.6261, 12566.1517],
    [3497, 2.7441, 5753.3849],
    [3418, 2.8289, 3.5231],
    [3136, 3.6277, 77713.7715],
    [2676, 4.4181, 7860.4194],
    [2343, 6.1352, 3930.2097],
    [1324, 0.7425, 11506.7698],
    [1273, 2.0371, 529.691],
    [1199, 1.1096, 1577.3435],
    [990, 5.233, 5884.927],
    [902, 2.045, 26.298],
    [857, 3.508, 398.149],
    [780, 1.179, 5223.694],
    [753, 2.533, 5507.553],
    [505, 4.583, 18849.228],
    [492, 4.205, 775.523],
  ],
  [
    [628331966747, 0, 0],
    [206059, 2.678235, 6283.07585],
    [4303, 2.6351, 12566.1517],
    [425, 1.59, 3.523],
  ],
  [
    [52919, 0, 0],
    [8720, 1.0721, 6283.0758],
    [309, 0.867, 12566.152],
  ],
];
/** The distance, in 1e-8 astronomical units. */
const DISTANCE = [
  [
    [100013989, 0, 0],
    [1670700, 3.0984635, 6283.07585],
    [13956, 3.05525, 12566.1517],
  ],
  [[103019, 1.10749, 6283.07585]],
];
const DELTA_T = 67; // seconds from UTC to terrestrial time, as pvlib has it
const J2000 = 946728000; // seconds since 1970
const DAY = 86400;
const DEGREE = Math.PI / 180;

/**
 * @param {number[][][]} powers
 * @param {number} t millennia
 */
function series(powers, t) {
  return powers.reduce(
    (sum, terms, power) =>
      sum + t ** power * terms.reduce((part, [a, b, c]) => part + a * Math.cos(b + c * t), 0) * 1e-8,
    0,
  );
}

/**
 * The sun at a moment, without refraction.
 * @param {{latitude: number, longitude: number, elevation: number}} place degrees and metres
 * @param {number} seconds since 1970, UTC
 * @returns {Angles}
 */
export function sunAngles({ latitude, longitude, elevation }, seconds) {
  const days = (seconds - J2000) / DAY;
  const t = (days + DELTA_T / DAY) / 365250;
  const century = 10 * t;
  const distance = series(DISTANCE, t);
  // Nutation, by its four largest terms
  const node = (125.04452 - 1934.136261 * century) * DEGREE;
  const mean = (280.4665 + 36000.7698 * century) * DEGREE;
  const moon = (218.3165 + 481267.8813 * century) * DEGREE;
  const nutation =
    (-17.2 * Math.sin(node) - 1.32 * Math.sin(2 * mean) - 0.23 * Math.sin(2 * moon) + 0.21 * Math.sin(2 * node)) / 3600;
  const tilt =
    23.4392911 -
    0.0130042 * century +
    (9.2 * Math.cos(node) + 0.57 * Math.cos(2 * mean) + 0.1 * Math.cos(2 * moon) - 0.09 * Math.cos(2 * node)) / 3600;
  const lambda = series(LONGITUDE, t) + Math.PI + (nutation - 20.4898 / 3600 / distance) * DEGREE;
  const e = tilt * DEGREE;
  const ascension = Math.atan2(Math.sin(lambda) * Math.cos(e), Math.cos(lambda));
  const declination = Math.asin(Math.sin(e) * Math.sin(lambda));
  const sidereal = 280.46061837 + 360.98564736629 * days + 0.000387933 * (days / 36525) ** 2 + nutation * Math.cos(e);
  const hour = (sidereal + longitude) * DEGREE - ascension;
  // Parallax
  const phi = latitude * DEGREE;
  const u = Math.atan(0.99664719 * Math.tan(phi));
  const x = Math.cos(u) + (elevation / 6378140) * Math.cos(phi);
  const y = 0.99664719 * Math.sin(u) + (elevation / 6378140) * Math.sin(phi);
  const parallax = Math.sin((8.794 / 3600 / distance) * DEGREE);
  const across = Math.cos(declination) - x * parallax * Math.cos(hour);
  const shift = Math.atan2(-x * parallax * Math.sin(hour), across);
  const seen = Math.atan2((Math.sin(declination) - y * parallax) * Math.cos(shift), across);
  const h = hour - shift;
  const altitude = Math.asin(Math.sin(phi) * Math.sin(seen) + Math.cos(phi) * Math.cos(seen) * Math.cos(h));
  const south = Math.atan2(Math.sin(h), Math.cos(h) * Math.sin(phi) - Math.tan(seen) * Math.cos(phi));
  return { altitude: altitude / DEGREE, azimuth: (((south / DEGREE + 180) % 360) + 360) % 360 };
}
