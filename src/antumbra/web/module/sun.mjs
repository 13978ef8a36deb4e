// @ts-check
/** The suns of days at a place: intervals of time, and the position of the sun in the middle of each. */

import { intervalsOf } from "./days.mjs";
import { sinCos } from "./elementary.mjs";
import { sunAngles } from "./sun_position.mjs";

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

/**
 * The altitude of the sun without refraction, and its azimuth clockwise from north, in degrees. From 1900 to 2199, both
 * are within 0.003 degrees of NREL's Solar Position Algorithm.
 * @param {number} time milliseconds since 1970
 * @param {number} latitude degrees
 * @param {number} longitude degrees
 * @returns {[number, number]}
 */
export function sunPosition(time, latitude, longitude) {
  const { altitude, azimuth } = sunAngles({ latitude, longitude, elevation: 0 }, time / 1000);
  return [altitude, azimuth];
}

/**
 * The unit vector towards an altitude and a bearing from the scene's own north axis, in degrees.
 * @param {number} altitude
 * @param {number} bearing
 * @param {"y" | "z"} up
 */
export function directionTo(altitude, bearing, up) {
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
