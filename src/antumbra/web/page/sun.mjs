// @ts-check
/** Local time and directions of the sun. Its position: `../module/sun_position.mjs`. */

import { midnight as beginOf, zoneOf } from "../module/days.mjs";
import { directionTo } from "../module/sun.mjs";

/**
 * Where the scene is on Earth: degrees, metres, and an IANA name, an offset such as +01:00, or null, the whole hour of the
 * longitude.
 * @typedef {{latitude: number, longitude: number, elevation: number, north: number, timezone: string | null}} Place
 */

/** @typedef {import("../module/sun_position.mjs").Angles} Angles */

const DAY = 86400;

/**
 * The unit vector towards angles, in the scene's axes.
 * @param {Angles} angles
 * @param {number} north degrees: true north, clockwise from the scene's own
 * @param {"y" | "z"} up
 */
export function towards({ altitude, azimuth }, north, up) {
  return directionTo(altitude, azimuth + north, up);
}

/** The zone that was asked for last: to make one takes longer than to ask it. */
let latest = { key: "", offset: (/** @type {number} */ _second) => 0 };

/** @param {Place} place */
function zoneAt({ timezone, longitude }) {
  const key = `${timezone} ${longitude}`;
  if (key !== latest.key) latest = { key, offset: zoneOf(timezone ?? undefined, longitude) };
  return latest.offset;
}

/**
 * Seconds that local time is ahead of UTC.
 * @param {Place} place
 * @param {number} seconds since 1970, UTC
 */
export function offsetAt(place, seconds) {
  return zoneAt(place)(seconds);
}

/**
 * Seconds since 1970, UTC, at which a day begins in local time.
 * @param {Place} place
 * @param {string} date such as 2026-06-21
 */
export function midnight(place, date) {
  return beginOf(Date.parse(`${date}T00:00:00Z`) / 1000, zoneAt(place));
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
 * The local day at an instant.
 * @param {Place} place
 * @param {number} seconds
 */
export function dateAt(place, seconds) {
  return new Date(1000 * (seconds + offsetAt(place, seconds))).toISOString().slice(0, 10);
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
