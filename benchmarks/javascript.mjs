// The part of javascript.py that runs in node: times both libraries in turns, and prints rows as JSON.
import { readFileSync } from "node:fs";
import { Scene } from "antumbra";
import * as THREE from "three";
import { MeshBVH, SAH } from "three-mesh-bvh";

const read = (name, Type) => {
  const bytes = readFileSync(name);
  return new Type(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
};
const median = (values) => values.sort((a, b) => a - b)[Math.floor(values.length / 2)];
const wrongIn = (found, truth) => found.reduce((n, value, k) => n + (value !== truth[k]), 0);

const { limits, soft, rounds } = JSON.parse(readFileSync("plan.json"));
const positions = read("positions", Float32Array);
const rows = [];

async function inTurns(ours, theirs) {
  const times = [[], []];
  const found = [null, null];
  for (let round = 0; round < rounds; round++)
    for (const [side, call] of [ours, theirs].entries()) {
      const begin = performance.now();
      found[side] = await call();
      times[side].push(performance.now() - begin);
    }
  return { ours: median(times[0]), theirs: median(times[1]), found };
}

const geometry = new THREE.BufferGeometry();
geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
const build = await inTurns(
  () => Scene.create(positions),
  () => new MeshBVH(geometry.clone(), { strategy: SAH }),
);
rows.push({ query: "build", rays: "", ours: build.ours, theirs: build.theirs, wrong: 0, wrong_theirs: 0 });
const [scene, bvh] = build.found;
const corners = bvh.geometry.index.array; // it sorts the triangles of a geometry
const faceOf = (index) => (index < 0 ? -1 : corners[3 * index] / 3);

function eachRay(origins, directions, limit, answer) {
  const ray = new THREE.Ray();
  for (let i = 0; i < origins.length / 3; i++) {
    ray.origin.fromArray(origins, 3 * i);
    ray.direction.fromArray(directions, 3 * i);
    const length = ray.direction.length(); // it takes unit directions
    ray.direction.divideScalar(length);
    answer(i, bvh.raycastFirst(ray, THREE.DoubleSide, 0, limit === null ? Infinity : limit * length));
  }
}

for (const [kind, limit] of Object.entries(limits)) {
  const [origins, directions] = ["origins", "directions"].map((name) => read(`${kind}-${name}`, Float32Array));
  const n = origins.length / 3;
  const options = limit === null ? {} : { tmax: limit };
  const queries = {
    "any hit": {
      ours: () => scene.occluded(origins, directions, options),
      fill: (out) => (i, hit) => {
        out[i] = hit ? 1 : 0;
      },
      plain: (value) => value,
      truth: read(`${kind}-blocked`, Uint8Array),
    },
    "closest hit": {
      ours: () => scene.closestHit(origins, directions, options).face,
      fill: (out) => (i, hit) => {
        out[i] = hit ? hit.faceIndex : -1;
      },
      plain: faceOf,
      truth: read(`${kind}-face`, Int32Array),
    },
  };
  for (const [query, { ours, fill, plain, truth }] of Object.entries(queries)) {
    const theirs = () => {
      const out = new Int32Array(n);
      eachRay(origins, directions, limit, fill(out));
      return out;
    };
    const timed = await inTurns(ours, theirs);
    const [wrong, wrong_theirs] = [timed.found[0], timed.found[1].map(plain)].map((found) => wrongIn(found, truth));
    rows.push({ query, rays: kind, ours: timed.ours, theirs: timed.theirs, wrong, wrong_theirs });
  }
}
{
  const [points, normals] = ["points", "normals"].map((name) => read(`soft-${name}`, Float32Array));
  const [starts, ends] = ["starts", "ends"].map((name) => read(`soft-${name}`, Float32Array));
  const ways = ends.map((x, k) => x - starts[k]);
  const truth = [read("soft-bits", Uint32Array), read("soft-blocked", Uint8Array)];
  const theirs = () => {
    const out = new Uint8Array(truth[1].length);
    eachRay(starts, ways, 1, (i, hit) => {
      out[i] = hit ? 1 : 0;
    });
    return out;
  };
  const timed = await inTurns(() => scene.visibility(points, normals, soft.light).bits, theirs);
  const [wrong, wrong_theirs] = timed.found.map((found, side) => wrongIn(found, truth[side]));
  const row = { query: "visibility", rays: "soft shadows", ours: timed.ours, theirs: timed.theirs * soft.share };
  rows.push({ ...row, wrong, wrong_theirs });
}
console.log(JSON.stringify(rows));
