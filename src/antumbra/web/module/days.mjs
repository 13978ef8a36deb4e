// @ts-check
/** Days in a time zone, and the intervals that they are divided into (`antumbra.sun.sun_positions`). */

import { toWhole } from "./elementary.mjs";

const FORMS = '"2026-06-21", "2026-03-21:2026-09-21", "2026-01-21:2026-12-21:7", or "year:2026"';
const ZONES = 'write a name such as "Europe/Amsterdam", or "+01:00"';
const DAY = 86400; // seconds, as in all of this module
const MOST_DAYS = 36600;

/**
 * The intervals of days, from midnight to midnight in local time: their middles in milliseconds, and their lengths. The
 * last interval of a day is shorter if the step does not divide the day.
 * @param {string | string[]} dates
 * @param {string | undefined} timezone
 * @param {number} longitude
 * @param {number} step minutes
 */
export function intervalsOf(dates, timezone, longitude, step) {
  if (!(step >= 1 / 60 && step <= 1440))
    throw new RangeError(`step is ${step}; it must be from a second to 1440 minutes`);
  const offset = zoneOf(timezone, longitude);
  const seconds = toWhole(60 * step);
  const out = [];
  for (const day of daysOf(dates)) {
    const end = midnight(day + DAY, offset);
    for (let start = midnight(day, offset); start < end; start += seconds) {
      const length = Math.min(seconds, end - start);
      out.push({ middle: 1000 * (start + Math.floor(length / 2)), hours: length / 3600 });
    }
  }
  return out;
}

/**
 * The distinct days of texts, ascending, as the seconds from 1970 to their midnight in UTC.
 * @param {string | string[]} dates
 */
function daysOf(dates) {
  const texts = (Array.isArray(dates) ? dates : [dates]).flatMap((text) => String(text).split(","));
  const days = new Set(texts.flatMap((text) => rangeOf(text.trim())));
  return [...days].sort((one, other) => one - other);
}

/** @param {string} text */
function rangeOf(text) {
  const [first, last = first, step = "1", ...more] = text.split(":");
  const year = first === "year";
  const [begin, end] = (year ? [`${last}-01-01`, `${last}-12-31`] : [first, last]).map((day) => dayOf(day, text));
  const days = (end - begin) / DAY + 1;
  if (more.length > 0 || !/^[1-9]\d*$/.test(step) || (year && step !== "1") || days < 1 || days > MOST_DAYS)
    throw new RangeError(`dates are ${text}; write ${FORMS}, with the first day before the last one`);
  return Array.from({ length: Math.ceil(days / Number(step)) }, (_, k) => begin + k * Number(step) * DAY);
}

/** @param {string} day @param {string} text */
function dayOf(day, text) {
  const seconds = /^\d{4}-\d{2}-\d{2}$/.test(day) ? Date.parse(`${day}T00:00:00Z`) / 1000 : Number.NaN;
  const exists = Number.isFinite(seconds) && new Date(1000 * seconds).toISOString().startsWith(day);
  if (!exists) throw new RangeError(`dates are ${text}, and ${day} is no day; write ${FORMS}`);
  return seconds;
}

/**
 * A function that says by how many seconds local time is ahead of UTC, at an instant.
 * @param {string | undefined} timezone
 * @param {number} longitude
 * @returns {(second: number) => number}
 */
export function zoneOf(timezone, longitude) {
  if (timezone === undefined) return () => 3600 * toWhole(longitude / 15);
  const fixed = /^([+-])(\d{1,2})(?::?(\d{2}))?$/.exec(timezone);
  if (fixed) {
    const minutes = 60 * Number(fixed[2]) + Number(fixed[3] ?? 0);
    if (minutes > 840 || Number(fixed[3] ?? 0) > 59) throw new RangeError(`timezone ${timezone} is unknown; ${ZONES}`);
    return () => (fixed[1] === "-" ? -60 : 60) * minutes;
  }
  let format;
  try {
    format = new Intl.DateTimeFormat("en-US", { timeZone: timezone, timeZoneName: "longOffset" });
  } catch {
    throw new RangeError(`timezone ${timezone} is unknown; ${ZONES}`);
  }
  return (second) => {
    const name = format.formatToParts(1000 * second).find(({ type }) => type === "timeZoneName")?.value ?? "";
    const [, sign, hours, minutes, seconds] = /GMT([+-])(\d+):(\d+)(?::(\d+))?/.exec(name) ?? ["", "+", "0", "0"];
    return (sign === "-" ? -1 : 1) * (3600 * Number(hours) + 60 * Number(minutes) + Number(seconds ?? 0));
  };
}

/**
 * The second at which a day begins in local time: the first of two, and where clocks skip midnight, by the offset before.
 * @param {number} day
 * @param {(second: number) => number} offset
 */
export function midnight(day, offset) {
  const [before, after] = [offset(day - DAY), offset(day + DAY)];
  const follows = offset(day - before) !== before && offset(day - after) === after;
  return day - (follows ? after : before);
}
