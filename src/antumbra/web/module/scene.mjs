// @ts-check
/** A scene of triangles that stay where they are, and exact queries of rays: `antumbra.Scene`. */

import { buildBlocks } from "./blocks.mjs";
import { checkMesh, checkPoints, checkRays, cullOf, faultOf } from "./checks.mjs";
import { boundsOf, frameOrigin, middleOf, receiversOf, recentre } from "./frame.mjs";
import { KernelModule } from "./kernels.mjs";
import { MOST_RAYS, traceRays } from "./rays.mjs";
import { visibilityOf } from "./shadows.mjs";
import { sunsOf } from "./sun.mjs";
import { sumHours } from "./sun_hours.mjs";
import { IN_NODE, threadCount } from "./threads.mjs";
import { buildTree, widen } from "./tree.mjs";

/** @typedef {import("./memory.mjs").MemoryArray} MemoryArray */
/** @typedef {import("./kernels.mjs").KernelInstance} KernelInstance */
/** @typedef {import("./lights.mjs").Light} Light */
/** @typedef {import("./shadows.mjs").Visibility} Visibility */

const AT_A_TIME = 16384; // triangles that are measured at a time

/**
 * Rays, as arrays of three numbers each. `t` counts in lengths of the direction; tmin = 0 and tmax = Infinity.
 * @typedef {object} RayOptions
 * @property {ArrayLike<number>} [targets] instead of directions: the rays are segments that end there
 * @property {number | ArrayLike<number>} [tmin] hits have t > tmin
 * @property {number | ArrayLike<number>} [tmax] hits have t < tmax
 * @property {Int32Array} [skipFace] for each ray, a face that it does not hit, or -1
 * @property {"front" | "back"} [cullFaces] faces that rays pass
 */

/**
 * @typedef {object} SceneOptions
 * @property {KernelModule} [kernels] of `loadKernels`; default: those beside this file
 * @property {number} [threads] that work on each call, where they can share memory: in node, and in pages that are
 *   isolated from others; default: as many as the machine has
 */

/**
 * @typedef {object} VisibilityOptions
 * @property {number} [samples] of the light for each point, 1 to 1024; default: 16. Point i uses set i % 4 of 16
 * @property {"front" | "back"} [cullFaces] faces that light passes
 */

/**
 * Nearest hits: for a miss, the face is -1, t is Infinity, and u and v are 0.
 * @typedef {{face: Int32Array, t: Float64Array, u: Float32Array, v: Float32Array}} Hits
 */

export class Scene {
  /** @type {KernelInstance} */ #kernels;
  /** @type {any[]} */ #tree;
  /** @type {number[]} */ #origin;
  /** @type {number[]} */ #middle;
  /** @type {import("./frame.mjs").Box} */ #box; // in the frame
  /** @type {import("./blocks.mjs").BlockTree | null} */ #blocks = null; // made for the first light
  /** @type {MemoryArray} */ #triangles; // of the tree, in the frame
  /** @type {Int32Array | null} */ #faces; // of the tree's triangles; null: all
  /** @type {Promise<KernelModule> | null} */ static #module = null;

  /**
   * Use `Scene.create`.
   * @param {KernelInstance} kernels
   * @param {Float32Array} positions
   * @param {ArrayLike<number> | null} indices
   */
  constructor(kernels, positions, indices) {
    this.triangles = (indices ? indices.length : positions.length / 3) / 3;
    this.#kernels = kernels;
    const bounds = boundsOf(positions);
    this.#origin = frameOrigin(bounds);
    this.#middle = middleOf(bounds);
    const { arena } = this.#kernels;
    const all = arena.array("f4", [this.triangles, 9]);
    recentre(positions, indices, this.#origin, all.view);
    this.#box = boundsOf(all.view);
    this.#faces = this.#solidFaces(all);
    this.#triangles = this.#kept(all);
    const bvh = this.#faces?.length === 0 ? null : buildTree(this.#kernels, this.#triangles);
    this.#tree = bvh ? widen(this.#kernels, bvh) : [];
  }

  /**
   * A scene of triangles.
   * @param {Float32Array} positions x, y and z of each vertex
   * @param {ArrayLike<number> | null} [indices] three vertices of each triangle; null: consecutive ones
   * @param {SceneOptions} [options]
   */
  static async create(positions, indices = null, { kernels, threads = threadCount() } = {}) {
    checkMesh(positions, indices);
    if (!(Number.isInteger(threads) && threads >= 1 && threads <= 1024))
      throw new RangeError(`threads is ${threads}; it must be a whole number from 1 to 1024`);
    if (!kernels) Scene.#module ??= loadKernels();
    const module = kernels ?? (await /** @type {Promise<KernelModule>} */ (Scene.#module));
    return new Scene(await module.instance(threads), positions, indices);
  }

  /** End the threads of the scene, and free its memory once nothing refers to it. Scenes of one thread need no call. */
  close() {
    this.#kernels.helpers.close();
  }

  /**
   * The scene of a `BufferGeometry` of three.js, in the coordinates of its vertices.
   * @param {any} geometry
   * @param {SceneOptions} [options]
   */
  static fromBufferGeometry(geometry, options = {}) {
    const position = geometry?.attributes?.position;
    if (position?.itemSize !== 3) throw new TypeError("the geometry has no positions of three numbers");
    const plain =
      position.array instanceof Float32Array && !position.isInterleavedBufferAttribute && !position.normalized;
    const positions = plain ? position.array : new Float32Array(3 * position.count);
    if (!plain)
      for (let vertex = 0; vertex < position.count; vertex++)
        positions.set([position.getX(vertex), position.getY(vertex), position.getZ(vertex)], 3 * vertex);
    return Scene.create(positions, geometry.index?.array ?? null, options);
  }

  /**
   * The faces with nonzero area, which no ray hits otherwise; null: all of them.
   * @param {MemoryArray} triangles
   */
  #solidFaces(triangles) {
    const { arena } = this.#kernels;
    const n = this.triangles;
    return arena.scratch(() => {
      const [areas, faults] = [arena.array("b1", [n]), arena.array("b1", [1])];
      areas.view.fill(1); // the kernel clears those of faces without area
      this.#kernels.run("antumbra.scene.triangle_setup:_find_areas", n, AT_A_TIME, triangles, areas, faults);
      if (faults.view[0] === 0) return null;
      const kept = areas.view;
      return Int32Array.from({ length: n }, (_, face) => face).filter((face) => kept[face] !== 0);
    });
  }

  /**
   * The triangles of the tree, at the front of their array.
   * @param {MemoryArray} triangles
   */
  #kept(triangles) {
    if (!this.#faces) return triangles;
    const view = triangles.view;
    this.#faces.forEach((face, row) => {
      view.copyWithin(9 * row, 9 * face, 9 * face + 9);
    });
    return triangles.rows(this.#faces.length);
  }

  /**
   * Whether each ray is blocked. A ray that touches an edge or a corner is.
   * @param {ArrayLike<number>} origins three numbers a ray
   * @param {ArrayLike<number> | null} directions three numbers a ray, of any nonzero length; or null, with targets
   * @param {RayOptions} [options]
   * @returns {Uint8Array} 1 where a ray is blocked
   */
  occluded(origins, directions, options = {}) {
    const out = new Uint8Array(origins.length / 3);
    this.#trace(origins, directions, options, true, (hits, first) => out.set(hits[0].view, first));
    return out;
  }

  /**
   * The nearest face that each ray hits.
   * @param {ArrayLike<number>} origins three numbers a ray
   * @param {ArrayLike<number>} directions three numbers a ray, of any nonzero length
   * @param {RayOptions} [options]
   * @returns {Hits}
   */
  closestHit(origins, directions, options = {}) {
    if (options.targets) throw new TypeError("closestHit takes directions, no targets");
    const n = origins.length / 3;
    const hits = { face: new Int32Array(n).fill(-1), t: new Float64Array(n).fill(Infinity) };
    const found = { ...hits, u: new Float32Array(n), v: new Float32Array(n) };
    this.#trace(origins, directions, options, false, ([, face, t, u, v], first) => {
      const faces = this.#faces;
      found.face.set(faces ? face.view.map((/** @type {number} */ k) => (k < 0 ? -1 : faces[k])) : face.view, first);
      found.t.set(t.view, first);
      found.u.set(u.view, first);
      found.v.set(v.view, first);
    });
    return found;
  }

  /**
   * Which samples of a light points see.
   * @param {ArrayLike<number>} points three numbers a point
   * @param {ArrayLike<number> | null} normals of any length, for points on surfaces: what is below them is not seen;
   *   null: the points are in free space
   * @param {Light} light
   * @param {VisibilityOptions} [options]
   * @returns {Visibility}
   */
  visibility(points, normals, light, { samples = 16, cullFaces } = {}) {
    checkPoints(points, normals);
    const cull = cullOf(cullFaces);
    if (light?.kind === "ambient" && !normals) throw new TypeError("ambient light needs the normals of the points");
    const receivers = receiversOf(points, normals, this.#origin, this.#middle);
    return visibilityOf(this.geometry, receivers, light, samples, cull);
  }

  /**
   * The scene in memory, for callers of kernels.
   * @returns {import("./shadows.mjs").Geometry}
   */
  get geometry() {
    const wide = this.#tree.length === 0 ? null : this.#tree;
    if (wide) this.#blocks ??= buildBlocks(this.#kernels, wide[5]);
    return {
      kernels: this.#kernels,
      wide,
      blocks: this.#blocks,
      origin: this.#origin,
      box: this.#box,
      triangles: this.#triangles,
      faces: this.#faces,
    };
  }

  /**
   * The hours of direct sun at points: of all suns whose centre a point sees, the hours that they stand for.
   * @param {ArrayLike<number>} points three numbers a point
   * @param {ArrayLike<number> | null} normals as in `visibility`
   * @param {import("./sun.mjs").SunOptions | import("./sun.mjs").Suns} suns a place and dates, or suns of `sunsOf`
   * @returns {Float64Array}
   */
  sunHours(points, normals, suns) {
    const given = "directions" in suns ? suns : sunsOf(suns);
    if (given.directions.length !== 3 * given.hours.length)
      throw new RangeError(
        `directions has ${given.directions.length} numbers for the hours of ${given.hours.length} suns`,
      );
    return sumHours(points.length / 3, given, (light) => this.visibility(points, normals, light));
  }

  /**
   * Trace rays, a million at a time.
   * @param {ArrayLike<number>} origins
   * @param {ArrayLike<number> | null} directions
   * @param {RayOptions} options
   * @param {boolean} anyHit
   * @param {(hits: MemoryArray[], first: number) => void} use takes the arrays of `HitArrays` from ray `first` on
   */
  #trace(origins, directions, options, anyHit, use) {
    const n = checkRays(origins, directions, options);
    if (this.#tree.length === 0) return;
    for (let first = 0; first < n; first += MOST_RAYS) {
      const rays = new RayPart(this.#kernels, first, Math.min(MOST_RAYS, n - first));
      this.#kernels.arena.scratch(() => {
        const list = rays.list(origins, directions, options, this.#origin, this.#faces);
        const hits = traceRays(this.#kernels, this.#tree, list, rays.n, anyHit);
        if (!hits) throw new RangeError(faultOf(origins, directions, options, first, first + rays.n));
        use(hits, first);
      });
    }
  }
}

/** Part of the rays of a call, in memory. */
class RayPart {
  /**
   * @param {KernelInstance} kernels
   * @param {number} first
   * @param {number} n
   */
  constructor(kernels, first, n) {
    this.arena = kernels.arena;
    this.first = first;
    this.n = n;
  }

  /**
   * The arguments of a `RayList`.
   * @param {ArrayLike<number>} origins
   * @param {ArrayLike<number> | null} directions
   * @param {RayOptions} options
   * @param {number[]} frame
   * @param {Int32Array | null} faces
   */
  list(origins, directions, options, frame, faces) {
    const { targets, tmin = 0, tmax = targets ? 1 : Infinity, skipFace, cullFaces } = options;
    const ends = /** @type {ArrayLike<number>} */ (targets ?? directions);
    const skip = skipFace && faces ? rowsOf(skipFace, faces) : skipFace;
    const cull = cullOf(cullFaces);
    const parts = [this.#points(origins), this.#points(ends), this.#number(tmin), this.#number(tmax)];
    return [...parts, this.#skip(skip), frame, this.n, cull, targets !== undefined];
  }

  /**
   * An `Operand`.
   * @param {ArrayLike<number>} values
   */
  #points(values) {
    const double = !(values instanceof Float32Array);
    const array = this.arena.array(double ? "f8" : "f4", [this.n, 3], part(values, 3 * this.first, 3 * this.n));
    return [array.address, 3 * array.itemsize, array.itemsize, Number(double)];
  }

  /**
   * A `Number`.
   * @param {number | ArrayLike<number>} value
   */
  #number(value) {
    if (typeof value === "number") return [0, 0, 0, value];
    const array = this.arena.array("f8", [this.n], part(value, this.first, this.n));
    return [array.address, 8, 1, 0];
  }

  /** @param {Int32Array | undefined} skip */
  #skip(skip) {
    if (!skip) return [0, 0, 0, -1];
    const array = this.arena.array("i4", [this.n], part(skip, this.first, this.n));
    return [array.address, 4, 0, 0];
  }
}

/**
 * n values from element `first` on.
 * @param {ArrayLike<number>} values
 * @param {number} first
 * @param {number} n
 */
function part(values, first, n) {
  const whole = /** @type {any} */ (values);
  return whole.subarray ? whole.subarray(first, first + n) : whole.slice(first, first + n);
}

/**
 * Rows of the tree's triangles for faces.
 * @param {Int32Array} wanted
 * @param {Int32Array} faces ascending
 */
function rowsOf(wanted, faces) {
  const rows = new Map(Array.from(faces, (face, row) => [face, row]));
  return wanted.map((face) => rows.get(face) ?? -1);
}

// --- Loading -----------------------------------------------------------------------------------------------------------

/**
 * The module of kernels: from bytes, or from the files beside this one.
 * @param {{wasm?: Uint8Array, list?: any}} [files]
 */
export async function loadKernels({ wasm, list } = {}) {
  const bytes = wasm ?? (await fileBeside("kernels.wasm"));
  const contents = list ?? JSON.parse(new TextDecoder().decode(await fileBeside("kernels.json")));
  return KernelModule.compile(bytes, contents);
}

/**
 * The bytes of a file beside this one, in node and in browsers.
 * @param {string} name
 * @returns {Promise<Uint8Array>}
 */
async function fileBeside(name) {
  const url = new URL(name, import.meta.url);
  if (url.protocol === "file:" && IN_NODE) {
    const files = await import(/** @type {string} */ ("node:fs/promises"));
    return files.readFile(url);
  }
  const answer = await fetch(url);
  if (!answer.ok) throw new Error(`${url} was not loaded: ${answer.status} ${answer.statusText}`);
  return new Uint8Array(await answer.arrayBuffer());
}
