// @ts-check
/** The page: unpacks the scene, starts the workers, and joins picture, sun, answers and proof. In a worker: its jobs. */

import { dayOf, drawDay, hoursOf, sentenceOf } from "./answer.mjs";
import { askBoth, changeOf, Divider } from "./before_after.mjs";
import { digestOf, missing, numberText, reasonOf, recordOf, verdictOf } from "./checks.mjs";
import { follow, Orbit } from "./orbit.mjs";
import { Picture, SAMPLES } from "./picture.mjs";
import { Pool, serve } from "./pool.mjs";
import { scaleBar } from "./scale.mjs";
import { SunPanel } from "./sun_panel.mjs";
import { restore, Toolbar, toolsOf } from "./tools.mjs";
import { pause, unpack } from "./unpack.mjs";
import { fill, WORDS } from "./words.mjs";

/** @typedef {import("./words.mjs").Words} Words */

const [BEFORE, AFTER] = [0, 1]; // the states of a scene that changes
const REACH = 0.01; // metres that surfaces of both states may be apart and count as the same

/** @param {string} id */
const part = (id) => /** @type {any} */ (document.getElementById(id));

class Page {
  /**
   * @param {any} about what `page_export.py` says of the scene
   * @param {Words} words
   */
  constructor(about, words) {
    this.about = about;
    this.words = words;
    this.pool = new Pool();
    this.camera = new Orbit(about.camera, about.up);
    this.sun = new SunPanel(about, words, () => {
      this.changed();
      clearTimeout(this.later);
      this.later = setTimeout(() => this.#answer().catch((error) => this.fail(error)), 60);
    });
    this.toolbar = new Toolbar(part("tools"), part("said"));
    /** @type {Picture[]} */
    this.pictures = [];
    this.divider = /** @type {Divider | null} */ (null);
    this.found = /** @type {any} */ (null);
    this.asked = /** @type {any} */ (null);
    this.objectOf = new Int32Array();
    this.states = /** @type {Uint8Array | null} */ (null);
    this.digest = /** @type {Promise<string | null>} */ (Promise.resolve(null));
    this.proved = true;
  }

  async open() {
    const { about, words } = this;
    this.#label();
    const arrays = await unpack(
      part("data").textContent,
      about.columns,
      (share) => this.#progress(words.unpacking, share),
      (bytes) => {
        this.digest = digestOf(bytes);
      },
    ).catch((error) => {
      throw new Error(reasonOf(error, words, about.triangles, words.damaged));
    });
    part("data").remove();
    this.#progress(words.building, 1);
    await pause();
    this.objectOf = arrays.objectOf;
    this.states = arrays.states ?? null;
    await this.#start(arrays);
    part("opening").hidden = true;
    this.#draw();
    await this.#prove(arrays);
  }

  /** @param {Record<string, any>} arrays */
  async #start({ positions, indices, colours, colourOf, wasm }) {
    const { about, states } = this;
    const shown = states ? [BEFORE, AFTER].map((state) => indicesIn(indices, states, state)) : [indices];
    const arrays = { positions, colours, colourOf, wasm };
    const scene = { arrays, states: shown, kernels: about.kernels, up: about.up };
    const source = part("code").textContent;
    await this.pool.start(source, scene, (shown.length * indices.length) / 3, (error) => this.fail(error));
  }

  #draw() {
    const canvas = part("picture");
    const meter = { exposure: 0 };
    const make = (/** @type {HTMLCanvasElement} */ on, /** @type {number} */ state) =>
      new Picture(
        on,
        this.pool,
        this.camera,
        () => this.sun.light,
        () => this.#count(),
        { state, meter },
      );
    this.pictures = [make(canvas, -1)];
    if (this.states) {
      this.divider = new Divider(
        part("divider"),
        part("pictureBefore"),
        [part("nameBefore"), part("nameAfter")],
        this.words,
      );
      this.pictures.push(make(part("pictureBefore"), BEFORE));
    }
    for (const tool of toolsOf(this)) this.toolbar.add(tool, (error) => this.fail(error));
    this.toolbar.say(restore(this));
    addEventListener("hashchange", () => this.toolbar.say(restore(this)));
    follow(
      canvas,
      this.camera,
      () => this.changed(),
      (x, y) => this.ask(x, y).catch((error) => this.fail(error)),
    );
    new ResizeObserver(() => this.changed()).observe(canvas);
    this.changed();
    for (const picture of this.pictures) picture.run().catch((error) => this.fail(error));
  }

  #count() {
    const samples = Math.min(...this.pictures.map((picture) => picture.samples));
    const { words } = this;
    part("samples").textContent = samples === SAMPLES ? "" : ` · ${fill(words.samples, { n: samples, all: SAMPLES })}`;
    document.body.dataset.samples = String(samples);
  }

  /** @param {any} error */
  fail(error) {
    const box = part("opening");
    box.hidden = false;
    box.setAttribute("role", "alert");
    box.textContent = fill(this.words.failed, { reason: reasonOf(error, this.words, this.about.triangles) });
    document.body.dataset.failed = "yes";
  }

  /**
   * Ask what a point of the picture sees.
   * @param {number} x pixels in the picture
   * @param {number} y
   */
  async ask(x, y) {
    const { clientWidth: width, clientHeight: height } = part("picture");
    const rays = this.camera.rays(width, height);
    const direction = rays.corner.map((c, k) => c + x * rays.dx[k] + y * rays.dy[k]);
    const state = this.divider && x < this.divider.share * width ? BEFORE : AFTER;
    this.asked = { origin: rays.origin, direction, state };
    part("answer").setAttribute("aria-busy", "true");
    await this.#answer();
  }

  async #answer() {
    const { asked, sun, about, words } = this;
    if (!asked) return;
    const when = sun.place && { place: sun.place, day: dayOf(sun.place, sun.date, about.up) };
    const { origin, direction, state } = asked;
    const question = { origin, direction, suns: when?.day.directions ?? new Float64Array(), now: sun.light.sun };
    const ask = (/** @type {any} */ each) => this.pool.run("ask", each, true);
    const both = this.states && (await askBoth(ask, question, state, this.states, REACH / about.metres));
    const found = both ? both[state] : await ask(question);
    if (asked !== this.asked) return;
    this.found = found;
    const nameOf = (/** @type {number} */ face) => about.objects[this.objectOf[face]] ?? "";
    const sentence = sentenceOf(found, when, sun.altitude, words, nameOf);
    part("answer").textContent = sentence;
    part("answer").dataset.hours = found && when ? String(hoursOf(when.day, found.states)) : "";
    part("answer").dataset.point = found ? JSON.stringify([found.point, found.normal]) : "";
    part("answer").setAttribute("aria-busy", "false");
    if (both) part("change").textContent = changeOf(both, when?.day ?? null, sun.altitude, words, nameOf);
    if (when) {
      this.#bar("day", both ? both[AFTER] : found, when.day, both ? words.after : "", sentence);
      if (both) this.#bar("dayBefore", both[BEFORE], when.day, words.before, sentence);
    }
    this.#mark();
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

  /** @param {Record<string, any>} arrays */
  async #prove(arrays) {
    const { about } = this;
    const states = this.states ? [-2, -1] : [-1];
    const records = states.map((state) => ({ ...recordOf(arrays, state), state }));
    const wrongs = await Promise.all(records.map((record) => this.pool.run("prove", record, true)));
    const [wrong, n] = [wrongs.reduce((sum, each) => sum + each, 0), records.length * records[0].faces.length];
    const digest = await this.digest;
    const found = { wrong, n, version: about.version, digest, recorded: about.bytes };
    const { ok, text } = verdictOf(found, this.words);
    this.proved = ok;
    const line = part("proof");
    line.textContent = text;
    line.dataset.wrong = String(wrong);
    if (ok) return;
    line.setAttribute("role", "alert");
    part("header").append(line); // where it is always seen
  }

  /** The camera, the sun or the size has changed. */
  changed() {
    for (const picture of this.pictures) picture.changed();
    const turn = this.sun.north - (this.camera.heading * 180) / Math.PI;
    part("north").style.transform = `rotate(${turn}deg)`;
    part("north").dataset.turn = String(turn);
    scaleBar(part("scale"), this.camera, part("picture").clientHeight, this.about, this.words);
    this.#mark();
  }

  #mark() {
    const canvas = part("picture");
    const place = this.found && this.camera.place(this.found.point, canvas.clientWidth, canvas.clientHeight);
    part("mark").hidden = !place;
    if (place) part("mark").style.translate = `${place[0]}px ${place[1]}px`;
  }

  /**
   * @param {string} what
   * @param {number} share
   */
  #progress(what, share) {
    if (part("doing").textContent !== what) part("doing").textContent = what; // so that it is said once
    part("progress").value = share;
  }

  #label() {
    const { words, about } = this;
    part("picture").setAttribute("aria-label", words.picture);
    part("tools").setAttribute("aria-label", words.tools);
    part("answer").textContent = words.hint;
    part("day").hidden = !about.place;
    part("day").style.visibility = "hidden";
    part("change").hidden = !about.changes;
    part("dayBefore").hidden = !about.place || !about.changes;
    part("dayBefore").style.visibility = "hidden";
    part("north").setAttribute("aria-label", words.north);
    part("proof").textContent = words.proofRunning;
    part("help").textContent = words.help;
    part("sun").setAttribute("aria-label", words.controls);
    const digest = about.digest;
    part("about").textContent = fill(words.scene, { triangles: numberText(about.triangles), digest });
  }
}

/**
 * The triangles that a state of the scene has; those that it lacks are at a point, where no ray meets them.
 * @param {Int32Array} indices
 * @param {Uint8Array} states
 * @param {number} state
 */
function indicesIn(indices, states, state) {
  return indices.map((vertex, k) => (states[Math.floor(k / 3)] & (1 << state) ? vertex : 0));
}

if (typeof document === "undefined") serve();
else {
  const about = JSON.parse(part("scene").textContent);
  const words = WORDS[document.documentElement.lang] ?? WORDS.en;
  const page = new Page(about, words);
  const lack = missing();
  if (lack) page.fail(fill(words.old, { missing: lack }));
  else page.open().catch((error) => page.fail(error));
}
