// @ts-check
/** The page: unpacks the scene, starts the workers, and joins pictures, sun, answers and proof. In a worker: its jobs. */

import { AnswerPanel } from "./answer_panel.mjs";
import { lookOf } from "./appearance.mjs";
import { AFTER, BEFORE, Divider } from "./before_after.mjs";
import { digestOf, missing, numberText, reasonOf, recordOf, verdictOf } from "./checks.mjs";
import { drawLegend } from "./layer.mjs";
import { LayerControls, nameLayers } from "./layer_controls.mjs";
import { Ruler } from "./measure.mjs";
import { follow, Orbit } from "./orbit.mjs";
import { part } from "./parts.mjs";
import { Picture, SAMPLES } from "./picture.mjs";
import { Pool, serve } from "./pool.mjs";
import { scaleBar } from "./scale.mjs";
import { SunPanel } from "./sun_panel.mjs";
import { SurfaceValues } from "./surface_values.mjs";
import { decodeTextures } from "./textures.mjs";
import { restore, Toolbar, toolsOf } from "./toolbar.mjs";
import { pause, unpack } from "./unpack.mjs";
import { Walk } from "./walk.mjs";
import { fill, WORDS } from "./words.mjs";

/** @typedef {import("./words.mjs").Words} Words */

const STILL_SAMPLES = 16; // of the still
const LONGEST_STILL = 5000; // milliseconds after which the day plays even if no picture is as fine as the still

class Page {
  /**
   * @param {any} about what `page_export.py` says of the scene
   * @param {Words} words
   */
  constructor(about, words) {
    this.about = about;
    this.words = words;
    this.failed = (/** @type {Error} */ error) => this.fail(error);
    this.pool = new Pool();
    this.camera = new Orbit(about.camera, about.up);
    this.sun = new SunPanel(about, words, () => {
      this.changed();
      this.layers?.sunChanged();
      clearTimeout(this.later);
      this.later = setTimeout(() => this.#answer(), 60);
    });
    this.answers = new AnswerPanel(about, words, this.pool, this.sun, (spot) => {
      this.#mark();
      this.layers?.asked(spot);
    });
    const name = (/** @type {number} */ face) => this.answers.nameOf(face);
    this.ruler = new Ruler(about, words, this.pool, this.camera, name, () => this.#answer());
    this.walk = new Walk(part("picture"), this.camera, this.pool, about.metres, (walking) => {
      part("help").textContent = walking ? words.walkHelp : words.help;
      part("walk").setAttribute("aria-pressed", String(walking));
      this.changed();
    });
    this.toolbar = new Toolbar(part("tools"), part("said"));
    /** @type {Picture[]} of the state after, or of the only one, and of the state before */
    this.pictures = [];
    this.divider = /** @type {Divider | null} */ (null);
    this.layers = /** @type {LayerControls | null} */ (null);
    this.digest = /** @type {Promise<string | null>} */ (Promise.resolve(null));
    this.proved = true;
    this.firstView = ""; // that the still shows
    this.patient = true; // the still may stay
    this.opened = false; // the pictures are seen
  }

  async open() {
    const { about, words } = this;
    if (location.hash) document.getElementById("still")?.remove(); // a link to another view
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
    this.#progress(words.building, null);
    await pause();
    Object.assign(this.answers, { objectOf: arrays.objectOf, states: arrays.states ?? null });
    if (about.layer) this.answers.values = new SurfaceValues(about.layer, arrays);
    await this.#start(arrays);
    this.#progress(words.drawing, null);
    part("opening").hidden = Boolean(document.getElementById("still")) && !document.body.dataset.failed;
    part("sun").inert = false;
    this.#draw(arrays.states ?? null);
    await this.#prove(arrays);
  }

  /** @param {Record<string, any>} arrays */
  async #start({ indices, states, ...arrays }) {
    const { about } = this;
    const shown = states ? [BEFORE, AFTER].map((state) => indicesIn(indices, states, state)) : [indices];
    const { wasm, objectOf, origins, directions, ...rest } = arrays;
    const { blocked, faces, distances, blockedBefore, facesBefore, distancesBefore, ...columns } = rest;
    const textures = await decodeTextures(about.look.textures, arrays, (share) =>
      this.#progress(this.words.unpacking, share),
    );
    const scene = { wasm, kernels: about.kernels, look: lookOf(about, columns, textures), states: shown };
    const source = part("code").textContent;
    await this.pool.start(source, scene, (shown.length * indices.length) / 3, this.failed);
  }

  /** @param {Uint8Array | null} states that have each face */
  #draw(states) {
    const { about, words, pool, camera, sun, failed } = this;
    const canvas = part("picture");
    const options = { sky: about.look.sky, meter: { exposure: 0 }, moving: () => sun.playing };
    const light = () => ({ ...sun.light, painted: Boolean(about.layer) && part("painted").checked });
    const make = (/** @type {HTMLCanvasElement} */ on, /** @type {number} */ state) =>
      new Picture(on, pool, camera, light, () => this.#count(), { ...options, state });
    this.pictures = [make(canvas, -1)];
    if (states) {
      const before = part("pictureBefore");
      this.divider = new Divider(part("divider"), before, [part("nameBefore"), part("nameAfter")], words);
      this.pictures.push(make(before, BEFORE));
    }
    this.layers = new LayerControls(about, words, pool, camera, sun, this.pictures[0], this.divider, failed);
    for (const tool of toolsOf(this)) this.toolbar.add(tool, failed);
    this.toolbar.say(restore(this));
    addEventListener("hashchange", () => this.toolbar.say(restore(this)));
    follow(
      canvas,
      camera,
      () => {
        this.changed();
        if (camera.walking) this.walk.settle().then((rises) => rises && this.changed(), failed);
      },
      (x, y) => this.#ask(x, y).catch(failed),
    );
    new ResizeObserver(() => this.changed()).observe(canvas);
    this.#say(0);
    this.changed();
    this.firstView = this.#view();
    setTimeout(() => {
      this.patient = !plays();
      if (document.body.dataset.samples) this.#open();
    }, LONGEST_STILL);
    for (const picture of this.pictures) picture.run().catch(failed);
  }

  /** What the picture depends on: the camera and the sun. */
  #view() {
    return JSON.stringify([this.camera.rays(100, 100), this.sun.setting]);
  }

  /** @param {number} samples of the picture */
  #say(samples) {
    const done = this.pictures.every((picture) => picture.samples === picture.most);
    const drawing = fill(this.words.samples, { n: samples, all: SAMPLES });
    part("samples").textContent = done ? "" : ` · ${drawing}`;
  }

  #count() {
    const { pictures } = this;
    const samples = Math.min(...pictures.map((picture) => picture.samples));
    this.#say(samples);
    document.body.dataset.samples = String(samples);
    this.sun.drawn = true;
    this.#open();
  }

  /** A picture is there: show it once it is as fine as the still, or the still no longer shows the view. */
  #open() {
    if (this.opened) return;
    const { pictures } = this;
    const still = document.getElementById("still");
    const shows = pictures.length === 1 && !this.about.layer && this.#view() === this.firstView;
    if (still && shows && this.patient && pictures[0].samples < STILL_SAMPLES) return;
    this.opened = true;
    part("opening").hidden = !document.body.dataset.failed;
    still?.classList.add("fading");
    still?.addEventListener("transitionend", () => still.remove());
    if (plays()) this.sun.playOnce();
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
   * A place was clicked: measure from it, or tell what it sees.
   * @param {number} x pixels in the picture
   * @param {number} y
   */
  async #ask(x, y) {
    const { clientWidth: width, clientHeight: height } = part("picture");
    const rays = this.camera.rays(width, height);
    const direction = rays.corner.map((c, k) => c + x * rays.dx[k] + y * rays.dy[k]);
    const click = { origin: rays.origin, direction, state: this.divider?.stateAt(x) ?? 0 };
    await (this.ruler.on ? this.ruler.clicked(click) : this.answers.ask(click));
  }

  #answer() {
    if (!this.ruler.on) this.answers.update().catch(this.failed);
  }

  /** @param {Record<string, any>} arrays */
  async #prove(arrays) {
    const { about } = this;
    const states = arrays.states ? [-2, -1] : [-1];
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
    this.layers?.viewChanged();
    const turn = this.sun.north - (this.camera.heading * 180) / Math.PI;
    part("north").style.transform = `rotate(${turn}deg)`;
    part("north").dataset.turn = String(turn);
    scaleBar(part("scale"), this.camera, part("picture").clientHeight, this.about, this.words);
    this.#mark();
  }

  #mark() {
    const canvas = part("picture");
    const { found } = this.answers;
    const place = found && this.camera.place(found.point, canvas.clientWidth, canvas.clientHeight);
    part("mark").hidden = !place;
    if (place) part("mark").style.translate = `${place[0]}px ${place[1]}px`;
    this.ruler.draw();
  }

  /**
   * @param {string} what
   * @param {number | null} share null: unknown
   */
  #progress(what, share) {
    if (part("doing").textContent !== what) part("doing").textContent = what; // so that it is said once
    if (share === null) part("progress").removeAttribute("value");
    else part("progress").value = share;
  }

  #label() {
    const { words, about } = this;
    part("picture").setAttribute("aria-label", words.picture);
    part("tools").setAttribute("aria-label", words.tools);
    part("north").setAttribute("aria-label", words.north);
    part("proof").textContent = words.proofRunning;
    part("help").textContent = words.help;
    part("sun").setAttribute("aria-label", words.controls);
    part("result").hidden = !about.layer;
    if (about.layer) {
      drawLegend(part("colours"), about.layer);
      part("layer").textContent = about.layer.unit ? `${about.layer.name} (${about.layer.unit})` : about.layer.name;
      part("painted").addEventListener("change", () => this.changed());
    }
    nameLayers(words, about.place);
    part("about").textContent = fill(words.scene, { triangles: numberText(about.triangles) });
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

/** Whether the address asks to play the day; not for people who prefer less motion. */
function plays() {
  return new URLSearchParams(location.search).has("play") && !matchMedia("(prefers-reduced-motion: reduce)").matches;
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
