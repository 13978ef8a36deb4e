// @ts-check
/** The suns of days at a place: intervals of time, and the position of the sun in the middle of each. */

import { intervalsOf } from "./days.mjs";
import { sinCos } from "./elementary.mjs";

/**
 * Where and when.
 * @typedef {object} SunOptions
 * @property {number} latitude degrees north
 * @property {number} longitude degrees east
 * @property {string | string[]} dates "2026-06-21", "2026-03-21:2026-09-21", with ":7" for every 7th day, or "year:2026"
 * @property {string} [timezone] "Europe/Amsterdam", "UTC" or "+01:00"; default: the whole hour of the longitude
 * @property {number} [step] minutes that each sun stands for; default: 60
 * @property {number} [north] degrees: true north, clockwise from the scene's own north axis, -z or y; default: 0
 * @property {"y" | "z"} [up] the scene's up axis; default: "y"
 */

/**
 * Suns above the horizon, in the order of time.
 * @typedef {object} Suns
 * @property {Float64Array} directions unit vectors towards each sun, in the scene's axes
 * @property {Float64Array} hours that each stands for
 * @property {Float64Array} [times] the middles of their intervals, in milliseconds since 1970
 * @property {Float64Array} [altitudes] degrees above the horizon, without refraction
 * @property {Float64Array} [azimuths] degrees, clockwise from true north
 */

const DEGREE = Math.PI / 180;
const SECOND = DEGREE / 3600; // of arc
const DAY = 86_400_000;
const CLOCK = 67; // seconds from universal to terrestrial time
const PARALLAX = 8.794 * SECOND;
const ABERRATION = 20.4898 * SECOND;

/** Terms of the earth's longitude [Reda and Andreas 2004]: a cos(b + c t) in 1e-8 radians, t in millennia. */
const LONGITUDE = [
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
];
const MOTION = [
  [628331966747, 0, 0],
  [206059, 2.678235, 6283.07585],
  [4303, 2.6351, 12566.1517],
];

/** @param {number[][]} terms @param {number} t */
const sum = (terms, t) => terms.reduce((all, [a, b, c]) => all + a * Math.cos(b + c * t), 0) * 1e-8;

/**
 * The altitude of the sun without refraction, and its azimuth clockwise from north, in degrees. From 1950 to 2050, both
 * are within 0.01 degrees of NREL's Solar Position Algorithm.
 * @param {number} time milliseconds since 1970
 * @param {number} latitude degrees
 * @param {number} longitude degrees
 * @returns {[number, number]}
 */
export function sunPosition(time, latitude, longitude) {
  const days = (time - Date.UTC(2000, 0, 1, 12)) / DAY;
  const century = (days + CLOCK / 86400) / 36525;
  const t = century / 10;
  const node = (125.04452 - 1934.136261 * century) * DEGREE;
  const mean = (280.4665 + 36000.7698 * century) * DEGREE;
  const moon = (218.3165 + 481267.8813 * century) * DEGREE;
  const [psi, tilt] = [
    -17.2 * Math.sin(node) - 1.32 * Math.sin(2 * mean) - 0.23 * Math.sin(2 * moon) + 0.21 * Math.sin(2 * node),
    9.2 * Math.cos(node) + 0.57 * Math.cos(2 * mean) + 0.1 * Math.cos(2 * moon) - 0.09 * Math.cos(2 * node),
  ].map((x) => x * SECOND);
  const obliquity = (23.4392911 - 0.0130042 * century) * DEGREE + tilt;
  const distance = 1.00013989 + 0.016707 * Math.cos(3.0984635 + 6283.07585 * t);
  const ecliptic = sum(LONGITUDE, t) + sum(MOTION, t) * t + 0.00052919 * t * t + Math.PI + psi - ABERRATION / distance;
  const ascension = Math.atan2(Math.sin(ecliptic) * Math.cos(obliquity), Math.cos(ecliptic));
  const declination = Math.asin(Math.sin(obliquity) * Math.sin(ecliptic));
  const sidereal = ((280.46061837 + 360.98564736629 * days) % 360) * DEGREE + psi * Math.cos(obliquity);
  const hour = sidereal + longitude * DEGREE - ascension;
  const [sine, cosine] = [Math.sin(latitude * DEGREE), Math.cos(latitude * DEGREE)];
  const height = sine * Math.sin(declination) + cosine * Math.cos(declination) * Math.cos(hour);
  const altitude = Math.asin(Math.max(-1, Math.min(1, height)));
  const westward = Math.atan2(Math.sin(hour), Math.cos(hour) * sine - Math.tan(declination) * cosine);
  const azimuth = (westward / DEGREE + 540) % 360;
  return [(altitude - (PARALLAX / distance) * Math.cos(altitude)) / DEGREE, azimuth];
}

/**
 * The unit vector towards an altitude and a bearing from the scene's own north axis, in degrees.
 * @param {number} altitude
 * @param {number} bearing
 * @param {"y" | "z"} up
 */
function directionTo(altitude, bearing, up) {
  const [[sinAltitude, cosAltitude], [sinBearing, cosBearing]] = [altitude, bearing].map((x) => sinCos(x * DEGREE));
  const [east, north] = [sinBearing * cosAltitude, cosBearing * cosAltitude];
  return up === "z" ? [east, north, sinAltitude] : [east, sinAltitude, -north];
}

/**
 * The suns of days at a place.
 * @param {SunOptions} options
 * @returns {Required<Suns>}
 */
export function sunsOf({ latitude, longitude, dates, timezone, step = 60, north = 0, up = "y" }) {
  for (const [name, value, most] of /** @type {[string, number, number][]} */ ([
    ["latitude", latitude, 90],
    ["longitude", longitude, 180],
    ["north", north, 360],
  ]))
    if (!(Math.abs(value) <= most))
      throw new RangeError(`${name} is ${value}; it must be from -${most} to ${most} degrees`);
  if (up !== "y" && up !== "z") throw new RangeError(`up is ${up}; it must be "y" or "z"`);
  const rows = [];
  for (const { middle, hours } of intervalsOf(dates, timezone, longitude, step)) {
    const [altitude, azimuth] = sunPosition(middle, latitude, longitude);
    if (altitude > 0) rows.push({ middle, hours, altitude, azimuth, way: directionTo(altitude, azimuth + north, up) });
  }
  if (rows.length === 0)
    throw new RangeError(`the sun is never above the horizon on ${dates}; give other dates, or check the place`);
  return {
    directions: Float64Array.from(rows.flatMap(({ way }) => way)),
    hours: Float64Array.from(rows, (row) => row.hours),
    times: Float64Array.from(rows, (row) => row.middle),
    altitudes: Float64Array.from(rows, (row) => row.altitude),
    azimuths: Float64Array.from(rows, (row) => row.azimuth),
  };
}
