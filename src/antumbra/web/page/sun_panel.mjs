// @ts-check
/** The controls of the sun: date and time with a place, otherwise its direction and height. */

import { sunAngles } from "../module/sun_position.mjs";
import { label, part } from "./parts.mjs";
import { clock, daysAfter, midnight, towards } from "./sun.mjs";
import { fill } from "./words.mjs";

/** @typedef {import("./sun.mjs").Place} Place */
/** @typedef {import("./words.mjs").Words} Words */

const MINUTES_A_SECOND = 60; // of the day that plays
const LONGEST = 20; // minutes between two pictures of the day that plays, so that a slow one is followed by no jump
const EVENING = 7; // degrees: height of the sun at which the day that plays once ends
const MINUTE = 60;

export class SunPanel {
  /**
   * @param {any} about
   * @param {Words} words
   * @param {() => void} changed
   */
  constructor(about, words, changed) {
    /** @type {Place | null} */
    this.place = about.place;
    this.north = this.place?.north ?? 0;
    this.up = about.up;
    this.words = words;
    this.changed = changed;
    this.playing = false;
    this.drawn = true; // the last light is seen
    this.date = about.date;
    this.day = part("date");
    this.first = part("first");
    this.second = part("second");
    this.button = part("play");
    this.output = part("when");
    this.shines = Boolean(this.place || about.angles); // otherwise the scene has other lights only
    if (this.place) this.#withPlace(about);
    else if (about.angles) this.#withAngles(about);
    else this.#withoutSun();
    for (const slider of [this.first, this.second]) slider.addEventListener("input", () => this.#moved());
    this.#show();
  }

  /** @param {any} about */
  #withPlace(about) {
    const { words } = this;
    label("date", words.date);
    label("first", words.time);
    this.day.value = this.date;
    Object.assign(this.first, { min: 0, max: 1439, step: 1, value: about.minute });
    this.second.closest("label").hidden = true;
    this.day.addEventListener("change", () => {
      this.setting = { ...this.setting, date: this.day.value };
    });
    this.button.addEventListener("click", () => this.#play());
    this.#name();
  }

  /** @param {any} about */
  #withAngles(about) {
    label("first", this.words.bearing);
    label("second", this.words.height);
    Object.assign(this.first, { min: 0, max: 359.9, step: 0.1, value: about.angles.azimuth });
    Object.assign(this.second, { min: 0, max: 90, step: 0.1, value: about.angles.altitude });
    this.day.closest("label").hidden = true;
    this.button.hidden = true;
  }

  /** What the user has set, by the names of a link. */
  get setting() {
    const [first, second] = [Number(this.first.value), Number(this.second.value)];
    if (!this.shines) return {};
    return this.place ? { date: this.date, minute: first } : { azimuth: first, altitude: second };
  }

  /** @param {Record<string, any>} setting */
  set setting({ date, minute, azimuth, altitude }) {
    if (this.place) {
      this.day.value = date;
      if (this.day.value) this.date = date;
      this.day.value = this.date;
    }
    if (this.shines) this.first.value = this.place ? minute : azimuth;
    if (this.shines && !this.place) this.second.value = altitude;
    this.#moved();
  }

  #withoutSun() {
    for (const each of [this.first, this.second, this.day]) each.closest("label").hidden = true;
    this.button.hidden = true;
    this.output.hidden = true;
  }

  /** The moment that is shown, in seconds since 1970; with a place. */
  get seconds() {
    const place = /** @type {Place} */ (this.place);
    const start = midnight(place, this.date);
    return Math.min(start + MINUTE * Number(this.first.value), midnight(place, daysAfter(this.date, 1)) - 1);
  }

  get angles() {
    return this.place
      ? sunAngles(this.place, this.seconds)
      : { azimuth: Number(this.first.value), altitude: Number(this.second.value) };
  }

  /** Degrees; null without a sun. */
  get altitude() {
    return this.shines ? this.angles.altitude : null;
  }

  /** @returns {Omit<import("./picture.mjs").Light, "painted">} */
  get light() {
    if (!this.shines) return { sun: null, daylight: 1 };
    const { angles } = this;
    const daylight = Math.min(1, Math.max(0.03, (angles.altitude + 6) / 14));
    return { sun: angles.altitude > 0 ? towards(angles, this.north, this.up) : null, daylight };
  }

  #moved() {
    this.#show();
    this.changed();
  }

  #show() {
    const { altitude, azimuth } = this.angles;
    const digits = { minimumFractionDigits: 1, maximumFractionDigits: 1 };
    const height = altitude.toLocaleString(this.words.locale, digits);
    const sun = fill(this.words.sunAt, { altitude: height, azimuth: azimuth.toFixed(0) });
    const time = this.place ? clock(this.place, this.seconds) : "";
    this.output.textContent = [time, altitude > 0 ? sun : this.words.night].filter(Boolean).join(" · ");
    this.output.dataset.angles = JSON.stringify([altitude, azimuth]);
    this.first.setAttribute("aria-valuetext", this.output.textContent);
    this.second.setAttribute("aria-valuetext", `${altitude.toFixed(0)}°`);
  }

  /** Play the rest of the day once, up to the long shadows of the evening. */
  playOnce() {
    if (this.place && !this.playing) this.#play(EVENING);
  }

  /** @param {number} [lowest] degrees: the height of the falling sun at which playing ends; without it, it goes on */
  #play(lowest) {
    this.playing = !this.playing;
    this.#name();
    if (!this.playing) this.changed();
    let last = performance.now();
    const step = (/** @type {number} */ now) => {
      if (!this.playing) return;
      const minutes = Math.min(LONGEST, Math.floor(((now - last) / 1000) * MINUTES_A_SECOND));
      if (minutes > 0 && this.drawn) {
        last = now;
        this.drawn = false;
        const { altitude } = this.angles;
        this.first.value = String((Number(this.first.value) + minutes) % 1440);
        if (lowest !== undefined && this.angles.altitude <= Math.min(lowest, altitude)) {
          this.playing = false;
          this.#name();
        }
        this.#moved();
      }
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  #name() {
    const name = this.playing ? this.words.stop : this.words.play;
    this.button.textContent = this.playing ? "❚❚" : "▶";
    this.button.setAttribute("aria-label", name);
    this.button.title = name;
  }
}
