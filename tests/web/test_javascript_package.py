"""The package for JavaScript, in node: its answers have the bits of Python's."""

import json
import lzma
import re
import subprocess

import numpy as np
import pytest

import antumbra as at
from antumbra.web.javascript_package import ENTRY
from antumbra.web.kernel_linking import called_kernels
from scene_in_node import HITS, MESHES, NODE, Asked, grid, without_node

pytestmark = without_node


def rays_of(vertices, n=2000, seed=8):
    """(origins, directions) float32: to vertices and midpoints, and random ones."""
    generator = np.random.default_rng(seed)
    lower, upper = vertices.min(0), vertices.max(0)
    origins = (lower + (upper - lower + 1) * generator.uniform(-0.5, 1.5, (n, 3))).astype(np.float32)
    aims = vertices[generator.integers(0, len(vertices), n)]
    aims[::2] = (aims[::2] + vertices[generator.integers(0, len(vertices), len(aims[::2]))]) / 2
    directions = aims - origins
    directions[::5] = generator.normal(size=directions[::5].shape)
    return origins, np.where((directions == 0).all(1, keepdims=True), np.float32(1), directions)


@pytest.mark.parametrize("name", MESHES)
def test_rays_have_the_bits_of_python(package, tmp_path, name):
    vertices, faces = MESHES[name]
    scene = at.Scene.from_arrays(vertices if faces is not None else vertices.reshape(-1, 3, 3), faces)
    asked, wanted = Asked(package, tmp_path, vertices, faces), []
    origins, directions = rays_of(vertices)
    generator = np.random.default_rng(1)
    tmin, tmax = generator.uniform(0, 0.5, len(origins)), generator.uniform(0.2, 3, len(origins))
    skip = generator.integers(-1, len(scene.triangles().vertices), len(origins)).astype(np.int32)
    cases = [({}, {}), ({"tmin": 0.25, "tmax": 1.0},) * 2, ({"tmin": tmin, "tmax": tmax},) * 2]
    cases += [({"cull_faces": side}, {"cullFaces": side}) for side in ("front", "back")]
    cases += [({"skip_face": skip}, {"skipFace": skip})]
    for starts, ways in (origins, directions), (origins.astype(np.float64) + 1e-9, directions.astype(np.float64)):
        for python, javascript in cases:
            asked.ask("occluded", starts, ways, **javascript)
            wanted.append({"blocked": scene.occluded(starts, ways, **python)})
            asked.ask("closestHit", starts, ways, **javascript)
            hits = scene.closest_hit(starts, ways, **python)
            wanted.append({each: getattr(hits, each) for each in HITS})
        asked.ask("occluded", starts, None, targets=starts + ways)
        wanted.append({"blocked": scene.occluded(starts, targets=starts + ways)})
    found = asked.answers()
    assert len(found) == len(wanted)
    for got, want in zip(found, wanted):
        for each, values in want.items():
            np.testing.assert_array_equal(got[each], values, err_msg=each)
    if name != "no area":
        assert 0 < wanted[0]["blocked"].sum() < len(origins)


ORIGINS, WAYS = rays_of(grid()[0], 3)
NAN = np.full(3, np.nan)
INVALID = {
    "origins hold NaN or infinity, or are beyond float32 (ray 1)": (
        "occluded", np.float64([[0, 1, 0], [np.nan, 0, 0], [0, 0, 0]]), WAYS, {},
    ),
    "direction of ray 2 is zero in float32; give every ray a direction": (
        "closestHit", ORIGINS, WAYS * np.float32([[1], [1], [0]]), {},
    ),
    "tmin must be finite and not negative (ray 0)": ("occluded", ORIGINS, WAYS, {"tmin": -1.0}),
    "tmax is NaN (ray 0)": ("occluded", ORIGINS, WAYS, {"tmax": NAN}),
    "directions has 6 numbers, and 3 rays need 9": ("occluded", ORIGINS, WAYS[:2], {}),
    "give either directions or targets": ("occluded", ORIGINS, None, {}),
    "segments take no tmin and no tmax": ("occluded", ORIGINS, None, {"targets": WAYS, "tmin": 0.5}),
    "closestHit takes directions, no targets": ("closestHit", ORIGINS, WAYS, {"targets": WAYS}),
    'cullFaces is both; it must be "front" or "back"': ("occluded", ORIGINS, WAYS, {"cullFaces": "both"}),
}  # fmt: skip


def test_invalid_rays_are_errors_with_a_cure(package, tmp_path):
    asked = Asked(package, tmp_path, *grid())
    for method, origins, directions, options in INVALID.values():
        asked.ask(method, origins, directions, **options)
    assert asked.answers() == list(INVALID)


@pytest.mark.parametrize(
    "positions, indices, message",
    [
        (np.float32([[0, 0, 0], [1, 0, 0]]), None, "a scene needs whole triangles"),
        (np.float32([[0, 0, 0], [np.inf, 0, 0], [0, 0, 1]]), None, "positions: vertex 1 is not finite"),
        (np.float64([[0, 0, 0], [1, 0, 0], [0, 0, 1]]), None, "positions must be a Float32Array"),
        (grid()[0], np.int32([0, 1, 900]), "indices: 900 at 2 is no vertex; there are 98"),
        (np.float32([[0, 0, 0], [1e30, 0, 0], [0, 0, 1]]), None, "at most 1e18 wide"),
    ],
)
def test_invalid_meshes_are_errors(package, tmp_path, positions, indices, message):
    (found,) = Asked(package, tmp_path, positions, indices).answers()
    assert message in found


GEOMETRY = """
const { Scene } = await import(process.argv[2]);
const rows = [0, 0, 0, 4, 0, 0, 0, 0, 4, 9, 9, 9];
const get = (k) => (i) => rows[3 * i + k];
const attribute = (array, more = {}) => ({
  array, itemSize: 3, count: 4, getX: get(0), getY: get(1), getZ: get(2), ...more,
});
const index = { array: new Uint16Array([0, 1, 2]) };
const answers = [];
for (const position of [attribute(new Float32Array(rows)), attribute(new Int8Array(12), { normalized: true })]) {
  const scene = await Scene.fromBufferGeometry({ attributes: { position }, index });
  answers.push(...scene.occluded([1, 1, 1, 3, 1, 3], [0, -1, 0, 0, -1, 0]));
}
try { await Scene.fromBufferGeometry({ attributes: {} }); } catch (error) { answers.push(error.message); }
console.log(JSON.stringify(answers));
"""


def test_geometries_of_three_js_become_scenes(package, tmp_path):
    script = tmp_path / "geometry.mjs"
    script.write_text(GEOMETRY)
    done = subprocess.run([NODE, script, package / ENTRY], check=True, capture_output=True, text=True)
    assert json.loads(done.stdout) == [1, 0, 1, 0, "the geometry has no positions of three numbers"]


MANY = """
const { Scene } = await import(process.argv[2]);
const corners = new Float32Array([0, 0, 0, 4, 0, 0, 0, 0, 4]);
const n = (1 << 20) + 5;
const origins = new Float32Array(3 * n).map((_, i) => (i % 3 === 1 ? 1 : 1 + 2 * (Math.floor(i / 3) % 2)));
const directions = new Float32Array(3 * n).map((_, i) => (i % 3 === 1 ? -1 : 0));
for (const threads of [1, 3]) {
  const scene = await Scene.create(corners, null, { threads });
  await new Promise((done) => setTimeout(done, threads > 1 ? 200 : 0)); // for the threads to start
  const blocked = scene.occluded(origins, directions);
  scene.close();
  const again = scene.occluded(origins.slice(0, 6), directions.slice(0, 6)); // by this thread alone
  console.log(blocked.every((bit, ray) => bit === 1 - (ray % 2)) && again[0] === 1 && again[1] === 0);
}
try { await Scene.create(corners, null, { threads: 0 }); } catch (error) { console.log(error.message); }
"""


def test_a_million_rays_are_traced_in_parts_and_by_several_threads(package, tmp_path):
    script = tmp_path / "many.mjs"
    script.write_text(MANY)
    done = subprocess.run([NODE, script, package / ENTRY], check=True, capture_output=True, text=True)
    assert done.stdout.splitlines() == ["true", "true", "threads is 0; it must be a whole number from 1 to 1024"]


def test_the_package_is_small_and_complete(package):
    about = json.loads((package / "package.json").read_text())
    assert all((package / file).exists() for file in about["exports"].values())
    assert len(lzma.compress((package / "kernels.wasm").read_bytes())) < 150_000
    kernels = json.loads((package / "kernels.json").read_text())["kernels"]
    assert {name.split()[0] for name in kernels} == {each.kernel for each in called_kernels()}


def test_the_example_of_the_readme_says_what_it_returns(package, tmp_path):
    (example,) = re.findall(r"```js\n(.*?)```", (package / "README.md").read_text(), re.S)
    lines = []
    for line in example.replace('"antumbra"', json.dumps(str(package / ENTRY))).splitlines():
        call, _, said = line.partition("; // ")
        shown = call.startswith("scene.")
        lines.append(f"print({call}, {json.dumps(said)});" if shown else line)
    show = "const plain = (x) => JSON.stringify(x, (_, v) => (ArrayBuffer.isView(v) ? [...v] : v));\n"
    show += "const print = (found, said) => console.log(plain(found), said);\n"
    script = tmp_path / "example.mjs"
    script.write_text("\n".join([show, *lines]))
    done = subprocess.run([NODE, script], check=True, capture_output=True, text=True)
    assert done.stdout.splitlines() == [
        "[1,0] Uint8Array [1, 0]",
        '{"face":[0],"t":[0.5],"u":[0.25],"v":[0.25]} { face: [0], t: [0.5], u: [0.25], v: [0.25] }',
        "[0,1] Float32Array [0, 1]",
    ]
