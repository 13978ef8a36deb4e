// @ts-check
/** What a worker of the page computes with: a scene in a memory of its own, its look, rows of pictures, and the proof. */

import { loadKernels, Scene } from "../module/scene.mjs";
import { Frame } from "./frame.mjs";
import { SurfaceValues } from "./surface_values.mjs";

export class Tracer {
  /** @type {Frame | null} */ #frame = null;

  /**
   * @param {Scene} scene
   * @param {import("./appearance.mjs").Look} look
   */
  constructor(scene, look) {
    const { positions, indices, origin } = look;
    this.scene = scene;
    this.look = look;
    this.up = look.up === "z" ? 2 : 1;
    this.mesh = { positions, indices, origin, up: this.up };
  }

  /**
   * @param {Uint8Array} wasm
   * @param {any} kernels the list of kernels
   * @param {import("./appearance.mjs").Look} look
   */
  static async create(wasm, kernels, look) {
    const module = await loadKernels({ wasm, list: kernels });
    const scene = await Scene.create(look.positions, look.indices, { kernels: module, threads: 1 });
    return new Tracer(scene, look);
  }

  /**
   * The unit normal of a face.
   * @param {number} face
   */
  normal(face) {
    const { positions: p, indices } = this.mesh;
    const [a, b, c] = [0, 1, 2].map((k) => 3 * indices[3 * face + k]);
    const [ux, uy, uz] = [p[b] - p[a], p[b + 1] - p[a + 1], p[b + 2] - p[a + 2]];
    const [vx, vy, vz] = [p[c] - p[a], p[c + 1] - p[a + 1], p[c + 2] - p[a + 2]];
    const n = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    const length = Math.hypot(...n) || 1;
    return n.map((each) => each / length);
  }

  /**
   * Rows of a picture.
   * @param {import("./frame.mjs").Band} band
   */
  band(band) {
    const { look, scene } = this;
    this.#frame ??= new Frame(scene.geometry, look, look.layer && new SurfaceValues(look.layer, look));
    return this.#frame.draw(band);
  }

  /**
   * The number of recorded rays whose answers have other bits here.
   * @param {Record<string, any>} recorded
   */
  prove({ origins, directions, blocked, faces, distances }) {
    const hits = this.scene.closestHit(origins, directions);
    const found = this.scene.occluded(origins, directions);
    let wrong = 0;
    for (let ray = 0; ray < faces.length; ray++)
      if (found[ray] !== blocked[ray] || hits.face[ray] !== faces[ray] || !Object.is(hits.t[ray], distances[ray]))
        wrong++;
    return wrong;
  }
}
