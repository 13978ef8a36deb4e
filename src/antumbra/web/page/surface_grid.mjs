// @ts-check
/**
 * Sensors on the faces, with the bits of `antumbra.grid_sensors`: square lattices in the planes of the faces, anchored in
 * the world. A face keeps its values in the cells of the box around its lattice, row by row.
 */

import { toWhole } from "../module/elementary.mjs";
import { cross, dot } from "../module/vectors.mjs";

const BLOCK = 256; // spacings between anchors
const PHASE = 0.5 + 2 ** -7; // spacings from an anchor to the lattice
const LEVEL = 1e-3; // slope of planes that are nearly horizontal
const MOST = 400_000; // cells, besides one for each face
const COARSER = 4; // ratio of the spacings of two levels
const MOST_LEVELS = 3;
const PART = 8192; // cells whose hours a worker finds at a time

/** @typedef {{positions: Float32Array, indices: Int32Array, origin: number[], up: number}} Mesh the origin: in the world */

/**
 * The lattice of a face: its corners relative to the anchor, its axes, and the box of its cells.
 * @typedef {{corner: number[], anchor: number[], normal: number[], across: number[], along: number[], flat: number[][],
 *   low: number[], columns: number, rows: number}} Lattice
 */

/** Rows of a face, or all rows of several faces. @typedef {{first: number, last: number, from: number, to: number}} Part */

/** @typedef {{spacing: number, cells: number, parts: Part[]}} Level */

/** @param {number[]} a */
const unit = (a) => {
  const length = Math.sqrt(dot(a, a));
  return a.map((x) => x / length);
};

export class SurfaceGrid {
  /**
   * @param {Mesh} mesh
   * @param {number} spacing units of the scene
   */
  constructor(mesh, spacing) {
    this.mesh = mesh;
    this.spacing = spacing;
    this.faces = mesh.indices.length / 3;
    this.starts = new Int32Array(this.faces + 1); // the first cell of each face
    this.cells = 0;
    for (let face = 0; face < this.faces; face++) {
      const lattice = this.lattice(face);
      this.cells += lattice ? Math.max(1, lattice.columns * lattice.rows) : 0;
      this.starts[face + 1] = this.cells;
    }
  }

  /**
   * The lattice of a face; null without an area.
   * @param {number} face
   * @returns {Lattice | null}
   */
  lattice(face) {
    const { positions, indices, origin, up } = this.mesh;
    const corners = [0, 1, 2].map((k) => origin.map((o, axis) => positions[3 * indices[3 * face + k] + axis] + o));
    const block = BLOCK * Math.min(this.spacing, 1e30);
    const anchor = origin.map((_, axis) => {
      const along = corners.map((corner) => corner[axis]);
      return toWhole((Math.min(...along) + Math.max(...along)) / 2 / block) * block;
    });
    const [a, b, c] = corners.map((corner) => corner.map((x, axis) => x - anchor[axis]));
    const twice = cross(
      b.map((x, axis) => x - a[axis]),
      c.map((x, axis) => x - a[axis]),
    );
    if (!(Math.sqrt(dot(twice, twice)) > 0)) return null;
    const normal = unit(twice);
    const vertical = up === 2 ? [0, 0, 1] : [0, 1, 0];
    let across = cross(vertical, normal);
    if (Math.sqrt(dot(across, across)) < LEVEL) across = cross(up === 2 ? [0, 1, 0] : [0, 0, -1], normal);
    across = unit(across);
    const along = cross(normal, across);
    const flat = [a, b, c].map((corner) => [dot(corner, across) / this.spacing, dot(corner, along) / this.spacing]);
    const [low, high] = [
      [0, 0],
      [0, 0],
    ];
    for (const k of [0, 1]) {
      low[k] = Math.ceil(Math.min(flat[0][k], flat[1][k], flat[2][k]) - PHASE);
      high[k] = Math.floor(Math.max(flat[0][k], flat[1][k], flat[2][k]) - PHASE);
    }
    const [columns, rows] = [0, 1].map((k) => Math.max(high[k] - low[k] + 1, 0));
    return { corner: a, anchor, normal, across, along, flat, low, columns, rows };
  }

  /**
   * The sensors of a part, in the order of Python, and the cell of each. Points are relative to the scene's origin.
   * @param {Part} part
   */
  sensors({ first, last, from, to }) {
    /** @type {number[]} */
    const points = [];
    /** @type {number[]} */
    const normals = [];
    /** @type {number[]} */
    const cells = [];
    for (let face = first; face < last; face++) {
      const lattice = this.lattice(face);
      if (!lattice) continue;
      const { low, columns, rows, flat, normal } = lattice;
      const before = cells.length;
      for (let row = from; row < Math.min(to, rows); row++)
        for (let column = 0; column < columns; column++) {
          const at = [low[0] + column + PHASE, low[1] + row + PHASE];
          if (!inside(flat, at)) continue;
          points.push(...this.#point(lattice, at));
          cells.push(this.starts[face] + row * columns + column);
        }
      if (cells.length === before && from === 0 && to >= rows) {
        const centre = [0, 1].map((k) => (flat[0][k] + flat[1][k] + flat[2][k]) / 3);
        points.push(...this.#point(lattice, centre));
        cells.push(this.starts[face]);
      }
      for (let k = before; k < cells.length; k++) normals.push(...normal);
    }
    return { points: Float64Array.from(points), normals: Float64Array.from(normals), cells: Int32Array.from(cells) };
  }

  /**
   * @param {Lattice} lattice
   * @param {number[]} at in the plane
   */
  #point({ corner, anchor, normal, across, along }, [x, y]) {
    const height = dot(corner, normal);
    return anchor.map((each, k) => {
      const world = this.spacing * (x * across[k] + y * along[k]) + height * normal[k] + each;
      return world - this.mesh.origin[k];
    });
  }

  /**
   * The cell of a point on a face.
   * @param {number} face
   * @param {Lattice} lattice
   * @param {number[]} point relative to the scene's origin
   */
  cellAt(face, { anchor, across, along, low, columns, rows }, point) {
    if (columns * rows === 0) return this.starts[face];
    const away = point.map((x, axis) => x + this.mesh.origin[axis] - anchor[axis]);
    const [column, row] = [across, along].map((axis, k) =>
      Math.max(0, Math.min([columns, rows][k] - 1, Math.round(dot(away, axis) / this.spacing - PHASE - low[k]))),
    );
    return this.starts[face] + row * columns + column;
  }

  /**
   * The values of all cells of a part: those of its sensors, and outside the faces the nearest one of the row; NaN for a
   * face without sensors in these rows.
   * @param {Part} part
   * @param {Int32Array} cells of the sensors
   * @param {Float64Array} values of the sensors
   */
  filled(part, cells, values) {
    const start = this.firstCell(part);
    const out = new Float64Array(this.#end(part) - start).fill(Number.NaN);
    for (let k = 0; k < cells.length; k++) out[cells[k] - start] = values[k];
    for (let face = part.first; face < part.last; face++) {
      const lattice = this.lattice(face);
      if (!lattice || lattice.columns * lattice.rows === 0) continue;
      const begin = this.starts[face] - start + (part.first === face ? part.from * lattice.columns : 0);
      const end = Math.min(out.length, this.starts[face + 1] - start);
      spread(out.subarray(begin, end), lattice.columns);
    }
    return out;
  }

  /** @param {Part} part */
  firstCell({ first, from }) {
    return this.starts[first] + (from > 0 ? from * (this.lattice(first)?.columns ?? 0) : 0);
  }

  /** @param {Part} part */
  #end({ first, last, to }) {
    const lattice = last === first + 1 ? this.lattice(first) : null;
    return lattice && to < lattice.rows ? this.starts[first] + to * lattice.columns : this.starts[last];
  }

  /** Parts of about as many cells: several faces, or rows of one. @returns {Part[]} */
  parts() {
    const parts = [];
    for (let first = 0, last = 0; first < this.faces; first = last) {
      while (last < this.faces && this.starts[last + 1] - this.starts[first] <= PART) last++;
      if (last > first) parts.push({ first, last, from: 0, to: Number.MAX_SAFE_INTEGER });
      else {
        last = first + 1;
        const { columns, rows } = /** @type {Lattice} */ (this.lattice(first));
        const most = Math.max(1, Math.floor(PART / columns));
        for (let from = 0; from < rows; from += most)
          parts.push({ first, last, from, to: Math.min(rows, from + most) });
      }
    }
    return parts;
  }
}

/**
 * Grids from coarse to fine: the finest with a round spacing that has at most `most` cells besides one for each face.
 * @param {Mesh} mesh
 * @param {number} [most]
 * @returns {Level[]}
 */
export function levelsOf(mesh, most = MOST) {
  let spacing = rounded(Math.sqrt(areaOf(mesh) / most));
  let grid = new SurfaceGrid(mesh, spacing);
  while (grid.cells > most + grid.faces) {
    spacing = rounded(1.5 * spacing);
    grid = new SurfaceGrid(mesh, spacing);
  }
  const grids = [grid];
  while (grids.length < MOST_LEVELS) {
    const coarse = new SurfaceGrid(mesh, COARSER * grids[0].spacing);
    if (coarse.cells > grids[0].cells / 2) break; // mostly one sensor a face, as before
    grids.unshift(coarse);
  }
  return grids.map((each) => ({ spacing: each.spacing, cells: each.cells, parts: each.parts() }));
}

/** @param {Mesh} mesh */
function areaOf({ positions: p, indices }) {
  let area = 0;
  for (let i = 0; i < indices.length; i += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => 3 * indices[i + k]);
    const twice = cross(
      [0, 1, 2].map((k) => p[b + k] - p[a + k]),
      [0, 1, 2].map((k) => p[c + k] - p[a + k]),
    );
    area += Math.sqrt(dot(twice, twice)) / 2;
  }
  return area;
}

/**
 * The least of 1, 2 and 5 times powers of ten that is not less.
 * @param {number} x
 */
function rounded(x) {
  const power = Math.floor(Math.log10(x));
  const found = [1, 2, 5, 10].find((each) => Number(`${each}e${power}`) >= x) ?? 10;
  return Number(`${found}e${power}`);
}

/**
 * Whether a point lies in a triangle; on an edge of two, in exactly one of them.
 * @param {number[][]} triangle
 * @param {number[]} at
 */
function inside(triangle, at) {
  for (let k = 0; k < 3; k++) {
    const [a, b] = [triangle[k], triangle[(k + 1) % 3]];
    const [x, y] = [b[0] - a[0], b[1] - a[1]];
    const side = x * (at[1] - a[1]) - y * (at[0] - a[0]);
    if (!(side > 0 || (side === 0 && (y > 0 || (y === 0 && x < 0))))) return false;
  }
  return true;
}

/**
 * Fill the cells without a value, which is NaN, from their row, and rows without any from the row before or after.
 * @param {Float64Array} values
 * @param {number} columns
 */
function spread(values, columns) {
  /** @type {Float64Array[]} */
  const rows = [];
  for (let at = 0; at < values.length; at += columns) rows.push(values.subarray(at, at + columns));
  for (const row of rows)
    copyAlong(
      columns,
      (k) => row[k],
      (k, from) => row.fill(row[from], k, k + 1),
    );
  copyAlong(
    rows.length,
    (k) => rows[k][0],
    (k, from) => rows[k].set(rows[from]),
  );
}

/**
 * Copy to each of n places without a value: from the last one before with a value, else from the first one with a value.
 * @param {number} n
 * @param {(k: number) => number} value
 * @param {(k: number, from: number) => void} copy
 */
function copyAlong(n, value, copy) {
  let from = 0;
  while (from < n && Number.isNaN(value(from))) from++;
  if (from === n) return;
  for (let k = 0; k < n; k++)
    if (!Number.isNaN(value(k))) from = k;
    else copy(k, from);
}
