// @ts-check
/** What a worker finds at places: the sun through the day, the horizon, sightlines, and the sensors that pixels show. */

import { boundsOf, middleOf, receiversOf } from "../module/frame.mjs";
import { directionTo } from "../module/sun.mjs";
import { dot } from "../module/vectors.mjs";
import { levelsOf, SurfaceGrid } from "./surface_grid.mjs";

/** @typedef {import("./tracer.mjs").Tracer} Tracer */
/** @typedef {import("./frame.mjs").Rays} Rays */

const GOLDEN = Math.PI * (3 - Math.sqrt(5));
const SKY_DIRECTIONS = 4096;

/** A ray to a place, in a state of the scene. @typedef {{origin: number[], direction: number[], state: number}} Click */

/** A place on a surface, and the normal of the side that was clicked. @typedef {{face: number, point: number[], normal: number[]}} Spot */

// What a place sees of a sun or in a direction: it is behind the surface, seen, blocked, or no direction
export const BEHIND = 0;
export const SEEN = 1;
export const BLOCKED = 2;
const OUTSIDE = 3;

// Of a pixel: no surface, or the side of a surface that has no sensors
export const NOTHING = -1;
export const BACK = -2;

/**
 * @param {Tracer} tracer
 * @param {Click} click
 * @returns {Spot | null}
 */
function spotAt(tracer, { origin, direction }) {
  const hit = tracer.scene.closestHit(Float32Array.from(origin), Float32Array.from(direction));
  const face = hit.face[0];
  if (face < 0) return null;
  const flat = tracer.normal(face);
  const side = dot(flat, direction) > 0 ? -1 : 1;
  return {
    face,
    point: origin.map((o, k) => o + hit.t[0] * direction[k]),
    normal: flat.map((n) => side * n),
  };
}

/**
 * What a place sees of the sun through the day, and of the sky; null if the ray meets nothing.
 * @param {Tracer} tracer
 * @param {Click & {suns: Float64Array, now: number[] | null, at?: Spot}} question `at`: the place, instead of the one
 *   that the ray meets
 */
function ask(tracer, { suns, now, at: given, ...click }) {
  const spot = given ?? spotAt(tracer, click);
  if (!spot) return null;
  const states = sunsAt(tracer, spot, suns);
  const at = now ? sunsAt(tracer, spot, Float64Array.from(now)) : null;
  const { face, point, normal } = spot;
  return { face, point, normal, ...states, now: at?.states[0], nowBlocker: at?.blockers[0], sky: skyAt(tracer, spot) };
}

/**
 * @param {Tracer} tracer
 * @param {Spot} spot
 * @param {Float64Array} suns
 */
function sunsAt(tracer, { face, point, normal }, suns) {
  const n = suns.length / 3;
  const states = new Uint8Array(n);
  const blockers = new Int32Array(n).fill(-1);
  const facing = Array.from({ length: n }, (_, i) => i).filter((i) => dot(normal, suns.subarray(3 * i)) > 0);
  const ways = Float64Array.from(facing.flatMap((i) => [suns[3 * i], suns[3 * i + 1], suns[3 * i + 2]]));
  const options = { skipFace: new Int32Array(facing.length).fill(face) };
  const hits = tracer.scene.closestHit(repeat(receiver(point, normal), facing.length), ways, options);
  facing.forEach((i, k) => {
    blockers[i] = hits.face[k];
    states[i] = hits.face[k] < 0 ? SEEN : BLOCKED;
  });
  return { states, blockers };
}

/**
 * The share of the sky above the horizon that a place sees.
 * @param {Tracer} tracer
 * @param {Spot} spot
 */
function skyAt(tracer, spot) {
  const ways = new Float32Array(3 * SKY_DIRECTIONS);
  for (let i = 0; i < SKY_DIRECTIONS; i++) {
    const height = (i + 0.5) / SKY_DIRECTIONS;
    const level = Math.sqrt(1 - height * height);
    const [a, b] = [level * Math.cos(i * GOLDEN), level * Math.sin(i * GOLDEN)];
    ways.set(tracer.up === 2 ? [a, b, height] : [a, height, b], 3 * i);
  }
  const states = look(tracer, spot, ways);
  return states.reduce((open, state) => open + Number(state === SEEN), 0) / SKY_DIRECTIONS;
}

/**
 * What a place sees in directions.
 * @param {Tracer} tracer
 * @param {Spot} spot
 * @param {Float32Array} ways
 */
function look(tracer, { face, point, normal }, ways) {
  const states = new Uint8Array(ways.length / 3);
  const facing = [...states.keys()].filter((i) => dot(normal, ways.subarray(3 * i)) > 0);
  const skipFace = new Int32Array(facing.length).fill(face);
  const some = Float32Array.from(facing.flatMap((i) => [ways[3 * i], ways[3 * i + 1], ways[3 * i + 2]]));
  const blocked = tracer.scene.occluded(repeat(receiver(point, normal), facing.length), some, { skipFace });
  facing.forEach((i, k) => {
    states[i] = blocked[k] ? BLOCKED : SEEN;
  });
  return states;
}

/**
 * The sky of a place, as a square picture with the zenith in the middle, north at the top, and equal steps of elevation.
 * @param {Tracer} tracer
 * @param {{spot: Spot, size: number, north: number}} question
 */
function horizon(tracer, { spot, size, north }) {
  const states = new Uint8Array(size * size).fill(OUTSIDE);
  const [pixels, ways] = [/** @type {number[]} */ ([]), /** @type {number[]} */ ([])];
  for (let i = 0; i < states.length; i++) {
    const [right, down] = [i % size, Math.floor(i / size)].map((x) => (2 * (x + 0.5)) / size - 1);
    const altitude = 90 * (1 - Math.hypot(right, down));
    if (altitude <= 0) continue;
    const azimuth = (Math.atan2(right, -down) * 180) / Math.PI;
    pixels.push(i);
    ways.push(...directionTo(altitude, azimuth + north, tracer.up === 2 ? "z" : "y"));
  }
  look(tracer, spot, Float32Array.from(ways)).forEach((state, k) => {
    states[pixels[k]] = state;
  });
  return states;
}

/** A point to look from: `height` above a place, or on its surface. @typedef {{spot: Spot, height: number}} Eye */

/**
 * Whether an eye sees a place, as `antumbra.line_of_sight` finds it, and the face that blocks the view.
 * @param {Tracer} tracer
 * @param {{eye: Eye, spot: Spot}} question
 */
function sightline(tracer, { eye, spot }) {
  const [start, end] = [eyePoint(tracer, eye), surfaceEnd(tracer, spot)];
  const way = end.map((x, k) => x - start[k]);
  const ahead = eye.height > 0 || dot(way, eye.spot.normal) > 0;
  if (!ahead || dot(way, spot.normal) >= 0) return { seen: false, blocker: -1 };
  const seen = !tracer.scene.occluded(start, null, { targets: end })[0];
  return { seen, blocker: seen ? -1 : tracer.scene.closestHit(start, way, { tmax: 1 }).face[0] };
}

/** @param {Tracer} tracer @param {Eye} eye */
function eyePoint(tracer, { spot, height }) {
  return height > 0
    ? spot.point.map((x, axis) => Math.fround(axis === tracer.up ? x + height : x))
    : surfaceEnd(tracer, spot);
}

/**
 * An end of a sightline on a surface, moved off it as Python does.
 * @param {Tracer} tracer
 * @param {Spot} spot
 */
function surfaceEnd(tracer, { point, normal }) {
  const { origins } = receiversOf(point, normal, [0, 0, 0], middleOf(boundsOf(tracer.mesh.positions)));
  return Array.from(origins);
}

/**
 * What the pixels of rows show: for `spacings`, the cell of each grid, NOTHING or BACK; for an `eye`, whether it sees the
 * surface. And how much each surface faces the camera, 0 to 255.
 * @param {Tracer} tracer
 * @param {{rays: Rays, width: number, first: number, rows: number, spacings: number[], eye: Eye | null}} question
 */
function surfaces(tracer, { rays, width, first, rows, spacings, eye }) {
  const n = width * rows;
  const [origins, directions] = [new Float32Array(3 * n), new Float32Array(3 * n)];
  for (let i = 0; i < n; i++) {
    const [x, y] = [(i % width) + 0.5, first + Math.floor(i / width) + 0.5];
    origins.set(rays.origin, 3 * i);
    for (let k = 0; k < 3; k++) directions[3 * i + k] = rays.corner[k] + x * rays.dx[k] + y * rays.dy[k];
  }
  const { face, t } = tracer.scene.closestHit(origins, directions);
  const hits = { face, points: new Float64Array(3 * n), normals: new Float64Array(3 * n), back: new Uint8Array(n) };
  const facing = new Uint8Array(n);
  for (let i = 0, flat = [0, 0, 0]; i < n; i++) {
    if (face[i] < 0) continue;
    if (i === 0 || face[i] !== face[i - 1]) flat = tracer.normal(face[i]);
    const way = directions.subarray(3 * i, 3 * i + 3);
    const along = dot(flat, way);
    hits.back[i] = Number(along > 0);
    facing[i] = Math.round((255 * Math.abs(along)) / Math.hypot(way[0], way[1], way[2]));
    for (let k = 0; k < 3; k++) {
      hits.points[3 * i + k] = origins[3 * i + k] + t[i] * way[k];
      hits.normals[3 * i + k] = along > 0 ? -flat[k] : flat[k];
    }
  }
  const maps = spacings.map((spacing) => cellsOf(gridOf(tracer, spacing), hits));
  return { facing, maps: eye ? [...maps, seenFrom(tracer, eye, hits)] : maps };
}

/** @typedef {{face: Int32Array, points: Float64Array, normals: Float64Array, back: Uint8Array}} Surfaces of pixels */

/**
 * @param {SurfaceGrid} grid
 * @param {Surfaces} surfaces
 */
function cellsOf(grid, { face, points, back }) {
  const cells = new Int32Array(face.length).fill(NOTHING);
  let lattice = null;
  for (let i = 0; i < face.length; i++) {
    if (face[i] < 0) continue;
    if (i === 0 || face[i] !== face[i - 1]) lattice = grid.lattice(face[i]);
    if (back[i] || !lattice) cells[i] = BACK;
    else cells[i] = grid.cellAt(face[i], lattice, [points[3 * i], points[3 * i + 1], points[3 * i + 2]]);
  }
  return cells;
}

/**
 * Which surfaces an eye sees, as `antumbra.viewshed` finds it: NOTHING without a surface, else SEEN or BLOCKED.
 * @param {Tracer} tracer
 * @param {Eye} eye
 * @param {Surfaces} surfaces
 */
function seenFrom(tracer, eye, { face, points, normals }) {
  const states = new Int32Array(face.length).fill(NOTHING);
  const hits = [...face.keys()].filter((i) => face[i] >= 0);
  if (hits.length === 0) return states;
  const [places, sides] = [points, normals].map((of) => {
    const out = new Float64Array(3 * hits.length);
    for (const [k, i] of hits.entries()) out.set(of.subarray(3 * i, 3 * i + 3), 3 * k);
    return out;
  });
  const at = eyePoint(tracer, eye);
  const { fraction } = tracer.scene.visibility(places, sides, { kind: "points", positions: at });
  hits.forEach((i, k) => {
    const away = at.map((x, axis) => places[3 * k + axis] - x);
    const ahead = eye.height > 0 || dot(away, eye.spot.normal) > 0;
    states[i] = ahead && fraction[k] === 1 ? SEEN : BLOCKED;
  });
  return states;
}

/** @type {WeakMap<Tracer, Map<number, SurfaceGrid>>} */
const grids = new WeakMap();

/**
 * @param {Tracer} tracer
 * @param {number} spacing
 */
function gridOf(tracer, spacing) {
  const made = grids.get(tracer) ?? new Map();
  grids.set(tracer, made);
  const grid = made.get(spacing) ?? new SurfaceGrid(tracer.mesh, spacing);
  made.set(spacing, grid);
  return grid;
}

/**
 * The hours of sun of the cells of a part of a grid.
 * @param {Tracer} tracer
 * @param {{spacing: number, part: import("./surface_grid.mjs").Part, suns: import("../module/sun.mjs").Suns}} question
 */
function hours(tracer, { spacing, part, suns }) {
  const grid = gridOf(tracer, spacing);
  const { points, normals, cells } = grid.sensors(part);
  const values = cells.length ? tracer.scene.sunHours(points, normals, suns) : new Float64Array();
  return { start: grid.firstCell(part), values: grid.filled(part, cells, values) };
}

/** Answers to questions, by name. @type {Record<string, (tracer: Tracer, question: any) => any>} */
export const QUESTIONS = {
  ask,
  horizon,
  hours,
  levels: (tracer) => levelsOf(tracer.mesh),
  sightline,
  spot: spotAt,
  surfaces,
};

const SHIFT = 2 ** -21; // of receivers off their surfaces, as in antumbra.query.receivers

/**
 * A point on a face, moved off it as far as float32 needs.
 * @param {number[]} point
 * @param {number[]} normal
 */
function receiver([x, y, z], normal) {
  const shift = SHIFT * Math.max(Math.abs(x), Math.abs(y), Math.abs(z));
  return [Math.fround(x + shift * normal[0]), Math.fround(y + shift * normal[1]), Math.fround(z + shift * normal[2])];
}

/** @param {number[]} point @param {number} n */
function repeat(point, n) {
  const out = new Float32Array(3 * n);
  for (let i = 0; i < n; i++) out.set(point, 3 * i);
  return out;
}
