// @ts-check
/** A camera that orbits around a target, or walks, moved by mouse, touch and keys. */

/** @typedef {import("./frame.mjs").Rays} Rays */

const STEEPEST = 1.55; // radians
const CLICK = 6; // pixels that a pointer may move in a click

export class Orbit {
  /**
   * @param {{position: number[], target: number[], vfov: number}} view
   * @param {string} up
   */
  constructor({ position, target, vfov }, up) {
    this.up = up;
    this.target = [...target];
    const [east, north, height] = this.#local(position.map((p, k) => p - target[k]));
    this.distance = Math.hypot(east, north, height);
    this.turn = Math.atan2(east, north);
    this.tilt = Math.asin(height / this.distance);
    this.tangent = Math.tan((vfov * Math.PI) / 360);
    this.nearest = this.distance / 1000;
    this.farthest = this.distance * 20;
    this.walking = false;
  }

  /** @param {number[]} v scene axes, as east, north and up */
  #local([x, y, z]) {
    return this.up === "z" ? [x, y, z] : [x, -z, y];
  }

  /** @param {number[]} v east, north and up, as scene axes */
  #world([east, north, height]) {
    return this.up === "z" ? [east, north, height] : [east, height, -north];
  }

  /** Right, up and towards the eye, unit vectors in the scene's axes. */
  get axes() {
    const [s, c] = [Math.sin(this.turn), Math.cos(this.turn)];
    const [high, level] = [Math.sin(this.tilt), Math.cos(this.tilt)];
    return [
      this.#world([-c, s, 0]),
      this.#world([-s * high, -c * high, level]),
      this.#world([s * level, c * level, high]),
    ];
  }

  get eye() {
    const back = this.axes[2];
    return this.target.map((t, k) => t + this.distance * back[k]);
  }

  /** Target, distance, turn and tilt: what `view` takes back. */
  get view() {
    return [...this.target, this.distance, this.turn, this.tilt];
  }

  /** @param {number[]} view */
  set view(view) {
    this.target = view.slice(0, 3);
    [this.distance, this.turn, this.tilt] = view.slice(3);
    this.orbit(0, 0);
    this.zoom(1);
  }

  /** Clockwise from the scene's north axis to where the camera looks, in radians. */
  get heading() {
    return this.turn + Math.PI;
  }

  /**
   * @param {number} width
   * @param {number} height
   * @returns {Rays}
   */
  rays(width, height) {
    const [right, above, back] = this.axes;
    const pixel = (2 * this.tangent) / height;
    const corner = back.map((b, k) => -b + (above[k] * pixel * height) / 2 - (right[k] * pixel * width) / 2);
    return { origin: this.eye, corner, dx: right.map((r) => r * pixel), dy: above.map((a) => -a * pixel) };
  }

  /**
   * Where a point is in a picture, or null behind the camera.
   * @param {number[]} point
   * @param {number} width
   * @param {number} height
   */
  place(point, width, height) {
    const offset = point.map((p, k) => p - this.eye[k]);
    const [x, y, z] = this.axes.map((axis) => axis.reduce((sum, a, k) => sum + a * offset[k], 0));
    if (z >= 0) return null;
    const scale = height / (2 * this.tangent * -z);
    return [width / 2 + x * scale, height / 2 - y * scale];
  }

  /**
   * @param {number} right radians
   * @param {number} up
   */
  orbit(right, up) {
    this.turn += right;
    this.tilt = Math.max(-STEEPEST, Math.min(STEEPEST, this.tilt + up));
  }

  /**
   * @param {number} right shares of the picture's height
   * @param {number} up
   */
  pan(right, up) {
    const [x, y] = this.axes;
    const size = 2 * this.tangent * this.distance;
    this.target = this.target.map((t, k) => t - size * (right * x[k] + up * y[k]));
  }

  /**
   * Turn the head: the eye stays where it is.
   * @param {number} right radians
   * @param {number} up
   */
  look(right, up) {
    const { eye } = this;
    this.orbit(right, -up);
    this.moveEye(eye);
  }

  /**
   * Move level, and up.
   * @param {number} forward in units of the scene
   * @param {number} right
   * @param {number} up
   */
  step(forward, right, up = 0) {
    const [s, c] = [Math.sin(this.turn), Math.cos(this.turn)];
    const way = this.#world([-s * forward - c * right, -c * forward + s * right, up]);
    this.target = this.target.map((t, k) => t + way[k]);
  }

  /**
   * Put the eye at a point, looking the same way.
   * @param {number[]} eye
   */
  moveEye(eye) {
    const back = this.axes[2];
    this.target = eye.map((e, k) => e - this.distance * back[k]);
  }

  /** @param {number} factor */
  zoom(factor) {
    this.distance = Math.max(this.nearest, Math.min(this.farthest, this.distance * factor));
  }
}

/**
 * Move a camera as the user does on an element.
 * @param {HTMLElement} element
 * @param {Orbit} camera
 * @param {() => void} moved
 * @param {(x: number, y: number) => void} clicked pixels in the element
 */
export function follow(element, camera, moved, clicked) {
  /** @type {Map<number, {x: number, y: number}>} */
  const pointers = new Map();
  let travel = 0;
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    if (pointers.size === 1) travel = 0;
  });
  element.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId);
    if (!last) return;
    const [dx, dy] = [event.offsetX - last.x, event.offsetY - last.y];
    travel += Math.hypot(dx, dy);
    if (travel < CLICK && pointers.size === 1) return;
    const others = [...pointers].filter(([id]) => id !== event.pointerId).map(([, place]) => place);
    const height = element.clientHeight;
    const angle = (2 * Math.atan(camera.tangent)) / height; // of a pixel
    if (camera.walking && others.length > 0) camera.step((-dy / height) * camera.distance, 0);
    else if (camera.walking) camera.look(-angle * dx, angle * dy);
    else if (others.length > 0) {
      const [other] = others;
      const before = Math.hypot(last.x - other.x, last.y - other.y);
      camera.zoom(before / Math.max(1, Math.hypot(event.offsetX - other.x, event.offsetY - other.y)));
      camera.pan(dx / 2 / height, -dy / 2 / height);
    } else if (event.buttons & 6 || event.shiftKey) camera.pan(dx / height, -dy / height);
    else camera.orbit(-0.006 * dx, 0.006 * dy);
    pointers.set(event.pointerId, { x: event.offsetX, y: event.offsetY });
    moved();
  });
  const end = (/** @type {PointerEvent} */ event) => {
    const single = pointers.delete(event.pointerId) && pointers.size === 0;
    if (single && travel < CLICK && event.type === "pointerup" && event.button === 0)
      clicked(event.offsetX, event.offsetY);
  };
  element.addEventListener("pointerup", end);
  element.addEventListener("pointercancel", end);
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const turns = 0.001 * event.deltaY * (event.deltaMode === 1 ? 30 : 1);
      if (camera.walking) camera.step(-turns * camera.distance, 0);
      else camera.zoom(Math.exp(turns));
      moved();
    },
    { passive: false },
  );
  /** @type {Record<string, [number, number]>} */
  const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  element.addEventListener("keydown", (event) => {
    if (camera.walking && event.key !== "Enter") return; // see `Walk`
    const arrow = arrows[event.key];
    if (arrow && event.shiftKey) camera.pan(-0.05 * arrow[0], -0.05 * arrow[1]);
    else if (arrow) camera.orbit(0.08 * arrow[0], 0.08 * arrow[1]);
    else if (event.key === "+" || event.key === "=") camera.zoom(0.9);
    else if (event.key === "-") camera.zoom(1 / 0.9);
    else if (event.key === "Enter") clicked(element.clientWidth / 2, element.clientHeight / 2);
    else return;
    event.preventDefault();
    if (event.key !== "Enter") moved();
  });
}
