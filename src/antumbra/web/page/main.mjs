// @ts-check
/** The page: unpacks the scene, starts the workers, and joins picture, sun, answers and proof. In a worker: its jobs. */

import { dayOf, drawDay, hoursOf, sentenceOf } from "./answer.mjs";
import { lookOf } from "./appearance.mjs";
import { follow, Orbit } from "./orbit.mjs";
import { Picture, SAMPLES } from "./picture.mjs";
import { Pool, serve } from "./pool.mjs";
import { scaleBar } from "./scale.mjs";
import { SunPanel } from "./sun_panel.mjs";
import { decodeTextures } from "./textures.mjs";
import { pause, unpack } from "./unpack.mjs";
import { Walk } from "./walk.mjs";
import { fill, WORDS } from "./words.mjs";

/** @typedef {import("./words.mjs").Words} Words */

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
      this.#changed();
      clearTimeout(this.later);
      this.later = setTimeout(() => this.#answer().catch((error) => this.fail(error)), 60);
    });
    this.found = /** @type {any} */ (null);
    this.asked = /** @type {any} */ (null);
    this.objectOf = new Int32Array();
  }

  async open() {
    const { about, words } = this;
    this.#label();
    const arrays = await unpack(part("data").textContent, about.columns, (share) =>
      this.#progress(words.unpacking, share),
    );
    part("data").remove();
    this.#progress(words.building, 1);
    await pause();
    this.objectOf = arrays.objectOf;
    const textures = await decodeTextures(about.look.textures, arrays, (share) =>
      this.#progress(words.unpacking, share),
    );
    const scene = { wasm: arrays.wasm, kernels: about.kernels, look: lookOf(about, arrays, textures) };
    const source = part("code").textContent;
    await this.pool.start(source, scene, about.triangles, (error) => this.fail(error));
    part("opening").hidden = true;
    const canvas = part("picture");
    this.picture = new Picture(
      canvas,
      this.pool,
      this.camera,
      () => this.sun.light,
      (samples) => {
        part("samples").textContent =
          samples === SAMPLES ? "" : ` · ${fill(words.samples, { n: samples, all: SAMPLES })}`;
        document.body.dataset.samples = String(samples);
      },
      about.look.sky !== null,
    );
    follow(
      canvas,
      this.camera,
      () => {
        this.#changed();
        if (this.camera.walking) walk.settle().then((rises) => rises && this.#changed());
      },
      (x, y) => this.ask(x, y),
    );
    const walk = new Walk(canvas, part("walk"), this.camera, this.pool, about.metres, (walking) => {
      part("help").textContent = walking ? words.walkHelp : words.help;
      this.#changed();
    });
    part("walk").hidden = false;
    new ResizeObserver(() => this.#changed()).observe(canvas);
    this.#changed();
    this.picture.run().catch((error) => this.fail(error));
    await this.#prove(arrays);
  }

  /** @param {any} error */
  fail(error) {
    const box = part("opening");
    box.hidden = false;
    box.setAttribute("role", "alert");
    box.textContent = fill(this.words.failed, { reason: error?.message ?? error });
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
    this.asked = { origin: rays.origin, direction };
    part("answer").setAttribute("aria-busy", "true");
    await this.#answer();
  }

  async #answer() {
    const { asked, sun, about, words } = this;
    if (!asked) return;
    const when = sun.place && { place: sun.place, day: dayOf(sun.place, sun.date, about.up) };
    const day = when?.day.directions ?? new Float64Array();
    const question = { ...asked, suns: day, now: sun.light.sun };
    const found = await this.pool.run("ask", question, true);
    if (asked !== this.asked) return;
    this.found = found;
    const sentence = sentenceOf(found, when, sun.altitude, words, (face) => this.#nameOf(face));
    part("answer").textContent = sentence;
    part("answer").dataset.hours = found && when ? String(hoursOf(when.day, found.states)) : "";
    part("answer").dataset.point = found ? JSON.stringify([found.point, found.normal]) : "";
    part("answer").setAttribute("aria-busy", "false");
    part("day").style.visibility = found ? "visible" : "hidden";
    if (found && when) {
      part("day").setAttribute("aria-label", fill(words.day, { sentence }));
      drawDay(part("day"), when.day, found.states, sun.seconds);
    }
    this.#mark();
  }

  /** @param {number} face */
  #nameOf(face) {
    return this.about.objects[this.objectOf[face]] ?? "";
  }

  /** @param {Record<string, any>} arrays */
  async #prove({ origins, directions, blocked, faces, distances }) {
    const n = faces.length;
    const wrong = await this.pool.run("prove", { origins, directions, blocked, faces, distances }, true);
    const phrase = wrong ? this.words.wrong : this.words.proved;
    part("proof").textContent = fill(phrase, { wrong, n, version: this.about.version });
    part("proof").dataset.wrong = String(wrong);
    if (wrong) part("proof").setAttribute("role", "alert");
  }

  /** The camera, the sun or the size has changed. */
  #changed() {
    this.picture?.changed();
    part("north").style.transform = `rotate(${this.sun.north - (this.camera.heading * 180) / Math.PI}deg)`;
    scaleBar(part("scale"), this.camera, part("picture").clientHeight, this.about.metres, this.words);
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
    part("doing").textContent = what;
    part("progress").value = share;
  }

  #label() {
    const { words, about } = this;
    part("picture").setAttribute("aria-label", words.picture);
    part("answer").textContent = about.place || about.angles ? words.hint : words.hintSky;
    part("day").hidden = !about.place;
    part("day").style.visibility = "hidden";
    part("north").setAttribute("aria-label", words.north);
    part("proof").textContent = words.proofRunning;
    part("help").textContent = words.help;
    part("walk").textContent = words.walk;
    part("sun").setAttribute("aria-label", words.controls);
    const triangles = about.triangles.toLocaleString(document.documentElement.lang);
    part("about").textContent = fill(words.scene, { triangles, digest: about.digest });
  }
}

/** What the page needs of a browser and is missing, or "". */
function missing() {
  const needed = {
    WebAssembly: "WebAssembly",
    DecompressionStream: "DecompressionStream",
    OffscreenCanvas: "OffscreenCanvas",
  };
  return Object.keys(needed).find((name) => !(name in globalThis)) ?? "";
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
