// @ts-check
/** Walking: its keys and steps; the eye stays at its height above what is below. */

/** @typedef {import("./orbit.mjs").Orbit} Orbit */
/** @typedef {import("./pool.mjs").Pool} Pool */

const EYE = 1.65; // metres above the ground
const AHEAD = 6; // distance of the point that the camera then orbits around, in heights of the eye
const NEAR = 4; // heights of the eye above the ground from which a camera starts to walk where it is
const [WALK, RUN] = [2.5, 10]; // metres a second
const LONGEST = 0.1; // seconds of a step
const LEAST = 1e-3; // rise that is seen, in heights of the eye

/** Steps forward and to the right. @type {Record<string, [number, number]>} */
const KEYS = {
  KeyW: [1, 0],
  ArrowUp: [1, 0],
  KeyS: [-1, 0],
  ArrowDown: [-1, 0],
  KeyA: [0, -1],
  ArrowLeft: [0, -1],
  KeyD: [0, 1],
  ArrowRight: [0, 1],
};

export class Walk {
  /** @type {Set<string>} */ #pressed = new Set();
  #running = false;
  #last = 0;

  /**
   * @param {HTMLElement} element that takes the keys
   * @param {Orbit} camera
   * @param {Pool} pool
   * @param {number} metres in a unit of the scene
   * @param {(walking: boolean) => void} moved
   */
  constructor(element, camera, pool, metres, moved) {
    this.element = element;
    this.camera = camera;
    this.pool = pool;
    this.metres = metres;
    this.eye = EYE / metres;
    this.up = camera.up === "z" ? 2 : 1;
    this.moved = moved;
    element.addEventListener("keydown", (event) => this.#key(event, true));
    element.addEventListener("keyup", (event) => this.#key(event, false));
    element.addEventListener("blur", () => this.#pressed.clear());
  }

  /** Start, or stop. */
  async toggle() {
    this.element.focus();
    if (this.camera.walking) this.stop();
    else await this.start();
    return "";
  }

  /** Stand on what is below the camera if it is near, otherwise at the centre of the picture. */
  async start() {
    const { camera } = this;
    this.#set(true);
    const { eye, axes } = camera;
    const below = await this.#meet(eye, this.#down);
    let floor = below && eye[this.up] - below[this.up] <= NEAR * this.eye ? below : null;
    floor ??= await this.#meet(
      eye,
      axes[2].map((b) => -b),
    );
    if (!camera.walking) return;
    if (!floor) {
      this.#set(false);
      return;
    }
    camera.tilt = 0;
    camera.distance = AHEAD * this.eye;
    camera.moveEye(floor.map((f, k) => f + (k === this.up ? this.eye : 0)));
    this.moved(true);
  }

  stop() {
    this.#pressed.clear();
    this.#set(false);
  }

  /** @param {boolean} walking */
  #set(walking) {
    this.camera.walking = walking;
    this.moved(walking);
  }

  get #down() {
    return [0, 1, 2].map((k) => (k === this.up ? -1 : 0));
  }

  /**
   * The point that a ray meets, or null.
   * @param {number[]} origin
   * @param {number[]} direction
   * @returns {Promise<number[] | null>}
   */
  async #meet(origin, direction) {
    const spot = await this.pool.run("spot", { origin, direction }, true);
    return spot?.point ?? null;
  }

  /**
   * @param {KeyboardEvent} event
   * @param {boolean} down
   */
  #key(event, down) {
    if (!this.camera.walking || event.ctrlKey || event.metaKey) return;
    if (event.code === "Escape" && down) this.stop();
    else if (event.code.startsWith("Shift")) this.#press("Shift", down);
    else if (event.code in KEYS) {
      event.preventDefault();
      this.#press(event.code, down);
      if (!this.#running) this.#run();
    }
  }

  /**
   * @param {string} code
   * @param {boolean} down
   */
  #press(code, down) {
    if (down) this.#pressed.add(code);
    else this.#pressed.delete(code);
  }

  #run() {
    this.#running = true;
    this.#last = performance.now();
    const step = async () => {
      const now = performance.now();
      const time = Math.min(LONGEST, (now - this.#last) / 1000);
      this.#last = now;
      const keys = [...this.#pressed].filter((code) => code in KEYS);
      this.#running = keys.length > 0 && this.camera.walking;
      if (!this.#running) return;
      const way = ((this.#pressed.has("Shift") ? RUN : WALK) / this.metres) * time;
      const [forward, right] = [0, 1].map((k) => keys.reduce((sum, code) => sum + KEYS[code][k], 0) * way);
      this.camera.step(forward, right);
      await this.settle();
      this.moved(this.camera.walking);
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  /** Put the eye at its height above the surface below it, and return whether that moves it. */
  async settle() {
    const { eye } = this.camera;
    const below = await this.#meet(eye, this.#down);
    if (!below || !this.camera.walking) return false;
    const rise = below[this.up] + this.eye - eye[this.up];
    this.camera.step(0, 0, rise);
    return Math.abs(rise) > LEAST * this.eye;
  }
}
