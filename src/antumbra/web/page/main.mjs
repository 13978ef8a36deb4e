// @ts-check
/** The page: unpacks the scene, starts the workers, and joins picture, sun, answers and proof. In a worker: its jobs. */

import { dayOf, drawDay, hoursOf, sentenceOf } from "./answer.mjs";
import { HorizonPlot } from "./horizon_plot.mjs";
import { drawLegend, textOf } from "./layer.mjs";
import { Ruler } from "./measure.mjs";
import { follow, Orbit } from "./orbit.mjs";
import { part } from "./parts.mjs";
import { Picture, SAMPLES } from "./picture.mjs";
import { Pool, serve } from "./pool.mjs";
import { scaleBar } from "./scale.mjs";
import { SunPanel } from "./sun_panel.mjs";
import { SurfaceValues } from "./surface_values.mjs";
import { Tools } from "./tools.mjs";
import { pause, unpack } from "./unpack.mjs";
import { fill, WORDS } from "./words.mjs";

/** @typedef {import("./words.mjs").Words} Words */

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
      this.tools?.sunChanged();
      clearTimeout(this.later);
      this.later = setTimeout(() => this.#answer().catch((error) => this.fail(error)), 60);
    });
    const name = (/** @type {number} */ face) => this.#nameOf(face);
    this.ruler = new Ruler(about, words, this.pool, this.camera, name, () => this.#answer());
    this.horizon = new HorizonPlot(this.pool, this.sun, words);
    this.picture = /** @type {Picture | null} */ (null);
    this.tools = /** @type {Tools | null} */ (null);
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
    const { origins, directions, blocked, faces, distances, objectOf, ...traced } = arrays;
    this.values = about.layer && new SurfaceValues(about.layer, arrays);
    const scene = {
      arrays: { ...traced, layer: about.layer },
      kernels: about.kernels,
      up: about.up,
      origin: about.origin,
    };
    const source = part("code").textContent;
    await this.pool.start(source, scene, about.triangles, (error) => this.fail(error));
    part("opening").hidden = true;
    const canvas = part("picture");
    this.picture = new Picture(
      canvas,
      this.pool,
      this.camera,
      () => ({ ...this.sun.light, painted: Boolean(about.layer) && part("painted").checked }),
      (samples) => {
        part("samples").textContent =
          samples === this.picture?.most ? "" : ` · ${fill(words.samples, { n: samples, all: SAMPLES })}`;
        document.body.dataset.samples = String(samples);
      },
    );
    const failed = (/** @type {Error} */ error) => this.fail(error);
    this.tools = new Tools(about, words, this.pool, this.camera, this.sun, this.picture, failed);
    follow(
      canvas,
      this.camera,
      () => this.#changed(),
      (x, y) => this.ask(x, y).catch(failed),
    );
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
    const click = { origin: rays.origin, direction };
    if (this.ruler.on) return this.ruler.clicked(click);
    this.asked = click;
    part("answer").setAttribute("aria-busy", "true");
    await this.#answer();
  }

  async #answer() {
    const { asked, sun, about, words } = this;
    if (this.ruler.on) return;
    if (!asked) {
      part("answer").textContent = words.hint;
      return;
    }
    const when = sun.place && { place: sun.place, date: sun.date, day: dayOf(sun.place, sun.date, about.up) };
    const day = when?.day.directions ?? new Float64Array();
    const question = { ...asked, suns: day, now: sun.light.sun };
    const found = await this.pool.run("ask", question, true);
    if (asked !== this.asked) return;
    this.found = found;
    const answer = sentenceOf(found, when, sun.altitude, words, (face) => this.#nameOf(face));
    const sentence = [this.#numberAt(found), answer].filter(Boolean).join(" ");
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
    this.tools?.asked(found);
    await this.horizon.show(found);
  }

  /**
   * The number of the result at a point, in words.
   * @param {any} found
   */
  #numberAt(found) {
    if (!found || !this.values) return "";
    const { layer } = this.values;
    const value = this.values.at(found.face, found.point, found.normal);
    const text = Number.isNaN(value) ? this.words.noValue : textOf(layer, value, document.documentElement.lang);
    part("answer").dataset.value = String(value);
    return `${layer.name}: ${text}.`;
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
    this.tools?.viewChanged();
    part("north").style.transform = `rotate(${this.sun.north - (this.camera.heading * 180) / Math.PI}deg)`;
    scaleBar(part("scale"), this.camera, part("picture").clientHeight, this.about.metres, this.words);
    this.#mark();
  }

  #mark() {
    const canvas = part("picture");
    const place = this.found && this.camera.place(this.found.point, canvas.clientWidth, canvas.clientHeight);
    part("mark").hidden = !place;
    if (place) part("mark").style.translate = `${place[0]}px ${place[1]}px`;
    this.ruler.draw();
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
    part("answer").textContent = words.hint;
    part("day").hidden = !about.place;
    part("day").style.visibility = "hidden";
    part("north").setAttribute("aria-label", words.north);
    part("proof").textContent = words.proofRunning;
    part("help").textContent = words.help;
    part("sun").setAttribute("aria-label", words.controls);
    const triangles = about.triangles.toLocaleString(document.documentElement.lang);
    part("result").hidden = !about.layer;
    if (about.layer) {
      drawLegend(part("colours"), about.layer);
      part("layer").textContent = about.layer.unit ? `${about.layer.name} (${about.layer.unit})` : about.layer.name;
      part("painted").addEventListener("change", () => this.#changed());
    }
    part("about").textContent = fill(words.scene, { triangles, digest: about.digest });
  }
}

/** What the page needs of a browser and is missing, if anything. */
function missing() {
  return ["WebAssembly", "DecompressionStream", "OffscreenCanvas"].find((name) => !(name in globalThis));
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
