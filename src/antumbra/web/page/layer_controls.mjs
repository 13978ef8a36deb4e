// @ts-check
/** What lies over the picture: hours of sun on the faces, or what a place sees; with the controls and the legend. */

import { dayName, dayOf, duration, STEP, sunsAbove } from "./answer.mjs";
import { BEFORE } from "./before_after.mjs";
import { eyeAt, showEye } from "./measure.mjs";
import { Overlay } from "./overlay.mjs";
import { Painting } from "./painting.mjs";
import { label, part } from "./parts.mjs";
import { SEEN } from "./questions.mjs";
import { fill } from "./words.mjs";

/** @typedef {import("./questions.mjs").Spot} Spot */
/** @typedef {import("./sun.mjs").Place} Place */
/** @typedef {import("./words.mjs").Words} Words */

const PAUSE = 150; // milliseconds between colourings while values come in
const [IN_SIGHT, OUT_OF_SIGHT] = [
  [255, 214, 74, 90],
  [16, 22, 48, 165],
];
/** Days that stand for a year, and minutes of the intervals of those days. */
const [MONTHLY, YEAR_STEP] = ["21", 60];

/**
 * Name the controls, which are seen before the rays are ready.
 * @param {Words} words
 * @param {Place | null} place
 */
export function nameLayers(words, place) {
  label("show", words.show);
  label("eye", words.eyeHeight);
  const kinds = {
    light: words.light,
    seen: words.seen,
    ...(place && { day: words.sunDay, year: words.sunYear }),
  };
  for (const [kind, text] of Object.entries(kinds)) part("show").add(new Option(text, kind));
  showEye();
}

export class LayerControls {
  /** @type {Painting | null} */ #painting = null;
  /** @type {Spot | null} */ #spot = null;
  #kind = "light";
  #painted = ""; // the days that are painted
  #view = "";
  /** @type {any} */ #later = 0;
  #waiting = false; // for the next colouring
  /** @type {[number, number]} */ #pointer = [-1, -1];

  /**
   * @param {any} about
   * @param {Words} words
   * @param {import("./pool.mjs").Pool} pool
   * @param {import("./orbit.mjs").Orbit} camera
   * @param {{place: Place | null, date: string}} sun
   * @param {import("./picture.mjs").Picture} picture
   * @param {import("./before_after.mjs").Divider | null} divider layers lie over the state after, on its side
   * @param {(reason: Error) => void} failed
   */
  constructor(about, words, pool, camera, sun, picture, divider, failed) {
    this.about = about;
    this.words = words;
    this.pool = pool;
    this.camera = camera;
    this.sun = sun;
    this.picture = picture;
    this.divider = divider;
    this.side = divider ? `${words.after}: ` : "";
    this.failed = failed;
    this.overlay = new Overlay(part("overlay"), pool, camera, failed);
    part("show").addEventListener("change", () => this.#choose(part("show").value).catch(failed));
    part("eye").addEventListener("input", () => this.#kind === "seen" && this.#showSight());
    part("paint").addEventListener("click", () => this.#press());
    for (const event of ["pointermove", "pointerdown"])
      part("picture").addEventListener(event, (/** @type {PointerEvent} */ { offsetX, offsetY }) =>
        this.#point(offsetX, offsetY),
      );
    part("picture").addEventListener("pointerleave", () => this.#point(-1, -1));
  }

  /** The camera or the size may have changed. */
  viewChanged() {
    const { clientWidth, clientHeight } = part("picture");
    const view = JSON.stringify(this.camera.rays(clientWidth, clientHeight));
    if (view !== this.#view) this.overlay.changed();
    this.#view = view;
  }

  /** The sun has changed. */
  sunChanged() {
    if (this.#kind !== "day" && this.#kind !== "year") return;
    clearTimeout(this.#later);
    this.#later = setTimeout(() => {
      if (this.#painted !== String(this.#days())) this.#paint().catch(this.failed);
    }, 2 * PAUSE);
  }

  /**
   * A place was asked.
   * @param {Spot | null} spot
   */
  asked(spot) {
    const moved = spot && this.#spot?.point.join() !== spot.point.join();
    this.#spot = spot;
    if (moved && this.#kind === "seen") this.#showSight();
  }

  /** @param {string} kind */
  async #choose(kind) {
    this.#painting?.stop();
    this.#kind = kind;
    showEye();
    part("paint").hidden = kind !== "day" && kind !== "year";
    part("legend").hidden = kind === "light";
    part("bar").hidden = part("command").hidden = kind === "seen";
    if (kind === "seen") this.#showSight();
    else if (kind === "light") this.#show(null);
    else await this.#paint();
  }

  /** @param {import("./overlay.mjs").Layer | null} layer */
  #show(layer) {
    this.overlay.show(layer);
    this.picture.pause(layer?.opaque ?? false);
  }

  // --- What a place sees

  #showSight() {
    const { words } = this;
    const spot = this.#spot;
    if (!spot) {
      part("scale-title").textContent = words.lookFrom;
      this.#show(null);
      return;
    }
    part("scale-title").replaceChildren(
      this.side,
      ...[
        ["seen", words.inSight],
        ["unseen", words.outOfSight],
      ].flatMap(([kind, text]) => {
        const swatch = document.createElement("span");
        swatch.className = `swatch ${kind}`;
        return [swatch, `${text} `];
      }),
    );
    part("value").textContent = "";
    this.#show({
      opaque: false,
      question: { spacings: [], eye: eyeAt(spot, this.about) },
      colour: ({ maps }, pixel, out) => out.set(maps[0][pixel] === SEEN ? IN_SIGHT : OUT_OF_SIGHT, 4 * pixel),
    });
  }

  // --- Hours of sun

  #days() {
    const { date } = this.sun;
    if (this.#kind === "day") return [date];
    return Array.from({ length: 12 }, (_, k) => `${date.slice(0, 4)}-${String(k + 1).padStart(2, "0")}-${MONTHLY}`);
  }

  async #paint() {
    const { words, about, sun } = this;
    const days = this.#days();
    this.#painted = String(days);
    part("value").dataset.state = "painting";
    part("paint").textContent = words.stop;
    const step = this.#kind === "day" ? STEP : YEAR_STEP;
    const place = /** @type {Place} */ (sun.place);
    const suns = sunsAbove(days.map((day) => dayOf(place, day, about.up, step)));
    const title = this.#kind === "day" ? words.dayScale : words.yearScale;
    part("scale-title").textContent =
      this.side + fill(title, { date: dayName(sun.date, words), year: sun.date.slice(0, 4) });
    if (!this.#painting) {
      const levels = await this.pool.run("levels", {}, true);
      this.#painting = new Painting(this.pool, levels, about.palette, () => this.#changed());
    }
    const painting = this.#painting;
    if (this.#painted !== String(days) || this.#kind === "light" || this.#kind === "seen") return;
    part("command").textContent = `antumbra sun --sensors grid:${painting.finest} --days ${days} --step ${step}`;
    if (this.overlay.layer !== painting) this.#show(painting);
    await painting.start(suns, days.length, () => this.overlay.changed(false));
  }

  #press() {
    if (this.#painting?.state === "painting") this.#painting.stop();
    else this.#paint().catch(this.failed);
  }

  /** Values have come in. */
  #changed() {
    if (this.#waiting) return;
    this.#waiting = true;
    setTimeout(() => {
      this.#waiting = false;
      if (this.overlay.layer !== this.#painting) return;
      this.overlay.repaint();
      this.#say();
    }, PAUSE);
  }

  /** @param {number} x @param {number} y */
  #point(x, y) {
    this.#pointer = this.divider?.stateAt(x) === BEFORE ? [-1, -1] : [x, y];
    if (this.#painting && this.overlay.layer === this.#painting) this.#say();
  }

  /** How far the painting is, and the value under the pointer. */
  #say() {
    const { words } = this;
    const painting = /** @type {Painting} */ (this.#painting);
    const at = this.overlay.at(...this.#pointer);
    const hours = at ? painting.hours(at.shown, at.pixel) / painting.days : Number.NaN;
    const share = Math.floor(100 * painting.share);
    const states = { painting: fill(words.percent, { share }), stopped: words.stopped, done: words.done };
    const spacing = (painting.spacing * this.about.metres).toLocaleString(words.locale, {
      maximumSignificantDigits: 3,
    });
    const grid = fill(words.grid, { spacing, state: states[painting.state] });
    const here = Number.isNaN(hours) ? "" : fill(words.here, { hours: duration(hours) });
    part("value").textContent = [grid, here].filter(Boolean).join(" · ");
    Object.assign(part("value").dataset, { state: painting.state, hours: Number.isNaN(hours) ? "" : String(hours) });
    part("paint").textContent = painting.state === "painting" ? words.stop : words.restart;
    painting.scale.draw(part("bar"), hours);
    part("bar").setAttribute("aria-label", `${part("scale-title").textContent}: 0 – ${painting.scale.top} h`);
  }
}
