// @ts-check
/** Local time and directions of the sun. Its position: `../module/sun_position.mjs`. */

/**
 * Where the scene is on Earth: degrees, metres, and an IANA name, an offset such as +01:00, or null, the whole hour of the
 * longitude.
 * @typedef {{latitude: number, longitude: number, elevation: number, north: number, timezone: string | null}} Place
 */

/** @typedef {import("../module/sun_position.mjs").Angles} Angles */

const DAY = 86400;
const DEGREE = Math.PI / 180;

/**
 * The unit vector towards angles, in the scene's axes.
 * @param {Angles} angles
 * @param {number} north degrees: true north, clockwise from the scene's own
 * @param {string} up "y" or "z"
 */
export function towards({ altitude, azimuth }, north, up) {
  const bearing = (azimuth + north) * DEGREE;
  const level = Math.cos(altitude * DEGREE);
  const [x, y, z] = [Math.sin(bearing) * level, Math.cos(bearing) * level, Math.sin(altitude * DEGREE)];
  return up === "z" ? [x, y, z] : [x, z, -y];
}

/**
 * Seconds that local time is ahead of UTC.
 * @param {Place} place
 * @param {number} seconds since 1970, UTC
 */
export function offsetAt(place, seconds) {
  const { timezone } = place;
  if (timezone === null) return 3600 * Math.round(place.longitude / 15);
  const fixed = /^([+-])(\d{1,2})(?::?(\d{2}))?$/.exec(timezone);
  if (fixed) return (fixed[1] === "-" ? -60 : 60) * (60 * Number(fixed[2]) + Number(fixed[3] ?? 0));
  const format = new Intl.DateTimeFormat("en-GB", {
    timeZone: timezone,
    hourCycle: "h23",
    year: "numeric",
    month: "numeric",
    day: "numeric",
    hour: "numeric",
    minute: "numeric",
    second: "numeric",
  });
  const [day, month, year, hour, minute, second] = format
    .formatToParts(1000 * seconds)
    .filter(({ type }) => type !== "literal")
    .map(({ value }) => Number(value));
  return Date.UTC(year, month - 1, day, hour, minute, second) / 1000 - Math.floor(seconds);
}

/**
 * Seconds since 1970, UTC, at which a day begins in local time.
 * @param {Place} place
 * @param {string} date such as 2026-06-21
 */
export function midnight(place, date) {
  const utc = Date.parse(`${date}T00:00:00Z`) / 1000;
  const first = utc - offsetAt(place, utc);
  return utc - offsetAt(place, first);
}

/**
 * The day after, or n days after.
 * @param {string} date
 * @param {number} n
 */
export function daysAfter(date, n) {
  return new Date(Date.parse(`${date}T00:00:00Z`) + 1000 * DAY * n).toISOString().slice(0, 10);
}

/**
 * Local clock time such as 14:05.
 * @param {Place} place
 * @param {number} seconds
 */
export function clock(place, seconds) {
  const local = new Date(1000 * (Math.round((seconds + offsetAt(place, seconds)) / 60) * 60));
  return local.toISOString().slice(11, 16);
}
