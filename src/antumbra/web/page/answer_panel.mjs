// @ts-check
/** What the page tells of the place that was clicked: its number, the sentence, the bar of the day, and the horizon. */

import { dayOf, drawDay, hoursOf, sentenceOf } from "./answer.mjs";
import { AFTER, askBoth, BEFORE, changeOf } from "./before_after.mjs";
import { HorizonPlot } from "./horizon_plot.mjs";
import { textOf } from "./layer.mjs";
import { part } from "./parts.mjs";
import { fill } from "./words.mjs";

/** @typedef {import("./questions.mjs").Click} Click */
/** @typedef {import("./questions.mjs").Spot} Spot */

const REACH = 0.01; // metres that surfaces of both states may be apart and count as the same

export class AnswerPanel {
  /** @type {Int32Array} of each face */ objectOf = new Int32Array();
  /** @type {Uint8Array | null} that have each face; null: the scene has one state only */ states = null;
  /** @type {import("./surface_values.mjs").SurfaceValues | null} */ values = null;
  /** @type {Click | null} */ #asked = null;
  /** @type {Spot | null} */ found = null;

  /**
   * @param {any} about
   * @param {import("./words.mjs").Words} words
   * @param {import("./pool.mjs").Pool} pool
   * @param {import("./sun_panel.mjs").SunPanel} sun
   * @param {(spot: Spot | null) => void} told
   */
  constructor(about, words, pool, sun, told) {
    this.about = about;
    this.words = words;
    this.pool = pool;
    this.sun = sun;
    this.told = told;
    this.horizon = new HorizonPlot(pool, sun, words);
    this.hint = sun.shines ? words.hint : words.hintSky;
    part("answer").textContent = this.hint;
    part("change").hidden = !about.changes;
    for (const [id, shown] of /** @type {const} */ ([
      ["day", about.place],
      ["dayBefore", about.place && about.changes],
    ])) {
      part(id).hidden = !shown;
      part(id).style.visibility = "hidden";
    }
  }

  /**
   * Tell what a place sees.
   * @param {Click} click
   */
  async ask(click) {
    this.#asked = click;
    part("answer").setAttribute("aria-busy", "true");
    await this.update();
  }

  /** Tell it anew, as the sun has changed. */
  async update() {
    const { sun, about, words, states } = this;
    const asked = this.#asked;
    if (!asked) {
      part("answer").textContent = this.hint;
      return;
    }
    const when = sun.place && { place: sun.place, date: sun.date, day: dayOf(sun.place, sun.date, about.up) };
    const question = { ...asked, suns: when?.day.directions ?? new Float64Array(), now: sun.light.sun };
    const ask = (/** @type {any} */ each) => this.pool.run("ask", each, true);
    const both = states && (await askBoth(ask, question, asked.state, states, REACH / about.metres));
    const found = both ? both[asked.state] : await ask(question);
    if (asked !== this.#asked) return;
    this.found = found;
    const nameOf = (/** @type {number} */ face) => this.nameOf(face);
    const answer = sentenceOf(found, when, sun.altitude, words, nameOf);
    const sentence = [this.#numberAt(found), answer].filter(Boolean).join(" ");
    part("answer").textContent = sentence;
    part("answer").dataset.hours = found && when ? String(hoursOf(when.day, found.states)) : "";
    part("answer").dataset.point = found ? JSON.stringify([found.point, found.normal]) : "";
    part("answer").setAttribute("aria-busy", "false");
    if (both) part("change").textContent = changeOf(both, when?.day ?? null, sun.altitude, words, nameOf);
    if (when) {
      this.#bar("day", both ? both[AFTER] : found, when.day, both ? words.after : "", sentence);
      if (both) this.#bar("dayBefore", both[BEFORE], when.day, words.before, sentence);
    }
    this.told(found);
    await this.horizon.show(found, asked.state);
  }

  /**
   * The name of the object of a face, or "".
   * @param {number} face
   */
  nameOf(face) {
    return this.about.objects[this.objectOf[face]] ?? "";
  }

  /**
   * The number of the result at a place, in words.
   * @param {Spot | null} found
   */
  #numberAt(found) {
    if (!found || !this.values) return "";
    const { layer } = this.values;
    const value = this.values.at(found.face, found.point, found.normal);
    const text = Number.isNaN(value) ? this.words.noValue : textOf(layer, value, this.words.locale);
    part("answer").dataset.value = String(value);
    return `${layer.name}: ${text}.`;
  }

  /**
   * @param {string} id of a canvas
   * @param {any} found null: nothing
   * @param {import("./answer.mjs").Day} day
   * @param {string} name of the state, or ""
   * @param {string} sentence
   */
  #bar(id, found, day, name, sentence) {
    const bar = part(id);
    bar.style.visibility = found ? "visible" : "hidden";
    bar.dataset.hours = found ? String(hoursOf(day, found.states)) : "";
    bar.previousElementSibling.textContent = found ? name : "";
    if (!found) return;
    bar.setAttribute("aria-label", fill(this.words.day, { sentence: name ? `${name}. ${sentence}` : sentence }));
    drawDay(bar, day, found.states, this.sun.seconds);
  }
}
