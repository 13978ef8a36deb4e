"""Baked files in other programs: Khronos' validator, three.js in headless Chromium, and Blender.

The first two run where `node`, the modules gltf-validator, three and playwright-core, and Chromium are:
npm install gltf-validator three playwright-core, and ANTUMBRA_NODE_MODULES names the folder node_modules.
Blender runs where ANTUMBRA_BLENDER_PYTHON names a Python that has its wheel, bpy.
"""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from baked_files import Glb, box, grid, primitive, scene_file
from gltf_files import Gltf
from scenes import scene_path

HERE = Path(__file__).parent


def node(script, modules, *arguments, **more):
    """The output of a script for node; skips the test if node or a module is missing."""
    folder, program = os.environ.get("ANTUMBRA_NODE_MODULES"), shutil.which("node")
    missing = [m for m in modules if folder is None or not (Path(folder) / m).is_dir()]
    if program is None or missing:
        pytest.skip(f"node or its modules {', '.join(missing)} are absent: set ANTUMBRA_NODE_MODULES")
    env = {**os.environ, "NODE_PATH": folder, **more}
    command = [program, str(HERE / script), *map(str, arguments)]
    done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def issues(path):
    return json.loads(node("validate.mjs", ["gltf-validator"], path))


def show(path, out, **view):
    """(h, w, 3) uint8: a file in three.js."""
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("Chromium is absent: install it, or name it in CHROMIUM")
    node("show.mjs", ["three", "playwright-core"], path, out, json.dumps(view), CHROMIUM=chromium)
    return np.asarray(Image.open(out).convert("RGB"))


BLEND = """
import sys, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
sys.path.insert(0, sys.argv[1])
from blender_lightmap import import_lit
print("lit", sorted(material.name for material in import_lit(sys.argv[2])))
scene, lens = bpy.context.scene, bpy.data.cameras.new("lens")
scene.camera = bpy.data.objects.new("camera", lens)
scene.collection.objects.link(scene.camera)
scene.camera.location, lens.type, lens.ortho_scale = (0, 0, 4), "ORTHO", 2.0
scene.render.engine, scene.cycles.samples, scene.cycles.max_bounces = "CYCLES", 16, 0
scene.render.resolution_x = scene.render.resolution_y = 64
scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
scene.render.filepath = sys.argv[3]
bpy.ops.render.render(write_still=True)
"""


def lightmap_file(folder):
    """A floor with a base colour, a texture coordinate set of its own, and a baked shadow; and its light at 64 x 64."""
    made = Gltf()
    look = made.add(
        "materials", name="floor", pbrMetallicRoughness={"baseColorFactor": [0.8, 0.4, 0.2, 1.0], "metallicFactor": 0.0}
    )
    uv = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
    made.node(mesh=made.mesh({**primitive(made, *grid([-2, 2], [-2, 2]), TEXCOORD_0=9 * uv), "material": look}))
    made.node(mesh=made.mesh(primitive(made, *box((-0.5, 1.0, -3.5), (0.5, 2, -2.5)))))
    path, sun = made.write(folder), at.DirectionalLight((0.0, -1.0, 1.0), 20.0, intensity=3.0)
    at.bake(path, folder / "lit.glb", "light", lights=sun, texture=256, spp=64)
    places = (np.arange(64) + 0.5) / 64 * 2 - 1
    points = np.stack(np.broadcast_arrays(places[None], 0.0, places[:, None]), -1)
    fraction = at.visibility(at.load(path), points, sun, normals=(0, 1, 0), spp=256).fraction
    radiance = 3.0 * np.sqrt(0.5) / np.pi * fraction[..., None] * np.array([0.8, 0.4, 0.2])
    return folder / "lit.glb", radiance


def test_three_shows_a_lightmap(tmp_path):
    """The loader of the examples: radiance is base colour times irradiance over pi."""
    pytest.importorskip("xatlas")
    path, radiance = lightmap_file(tmp_path)
    view = {"size": [64, 64], "position": [0, 4, 1e-4], "target": [0, 0, 0], "vfov": 2 * np.degrees(np.arctan(0.25))}
    seen = show(path, tmp_path / "out.png", **view, linear=True, ambient=0, lightmap=True) / 255.0
    assert np.ptp(radiance) > 0.4
    assert np.abs(seen - radiance).mean() < 0.01 and np.percentile(np.abs(seen - radiance), 95) < 0.06


def test_blender_shows_a_lightmap(tmp_path):
    openexr, python = pytest.importorskip("OpenEXR"), os.environ.get("ANTUMBRA_BLENDER_PYTHON")
    pytest.importorskip("xatlas")
    if python is None:
        pytest.skip("Blender is absent: name a Python that has its wheel bpy in ANTUMBRA_BLENDER_PYTHON")
    path, radiance = lightmap_file(tmp_path)
    lightmaps = HERE.parents[1] / "examples" / "lightmaps"
    command = [python, "-c", BLEND, str(lightmaps), str(path), str(tmp_path / "out.exr")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "'floor']" in done.stdout, done.stderr[-2000:]
    with openexr.File(str(tmp_path / "out.exr")) as file:
        channels = file.channels()
        seen = next(channels[name].pixels for name in ("RGBA", "RGB") if name in channels)[..., :3]
    assert np.abs(seen - radiance).mean() < 0.01 and np.percentile(np.abs(seen - radiance), 95) < 0.06


BAKES = [
    {},
    {"what": "bent-normal"},
    {"what": "sun", "attribute": "_SUN"},
    {"texture": 64, "bits": 16},
    {"what": "light", "texture": 64, "bounces": 1},
    {"what": "light", "texture": 64, "unlit": True},
    {"what": "bent-normal", "texture": 64},
]


@pytest.mark.parametrize("options", BAKES)
def test_small_files_are_valid(tmp_path, options):
    path = scene_file(tmp_path, grid([-1, 0, 1], [-1, 0, 1]), box((-0.5, 0.2, -0.5), (0.5, 1, 0.5)))
    assert issues(path)["numErrors"] == 0
    at.bake(path, tmp_path / "out.glb", spp=4, **options)
    found = issues(tmp_path / "out.glb")
    assert found["numErrors"] == found["numWarnings"] == 0, found["messages"]
    (tmp_path / "bad.glb").write_bytes((tmp_path / "out.glb").read_bytes().replace(b'"SCALAR"', b'"SCALES"'))
    assert issues(tmp_path / "bad.glb")["numErrors"] > 0  # the validator does find errors


@pytest.mark.parametrize(
    "name", ["CesiumMilkTruck.glb", "CesiumMan.glb", "SimpleInstancing.glb", "AnimatedMorphCube.glb"]
)
@pytest.mark.parametrize("options", [{}, {"texture": 128}])
def test_real_files_are_as_valid_as_before(tmp_path, name, options):
    path = scene_path(f"gltf/{name}")
    before = issues(path)
    at.bake(path, tmp_path / "out.glb", spp=4, **options)
    found = issues(tmp_path / "out.glb")
    assert found["numErrors"] == 0 and found["numWarnings"] <= before["numWarnings"], found["messages"]


def test_three_shows_the_values_at_vertices(tmp_path):
    """A floor seen from straight above: each pixel is the value that is interpolated between the vertices."""
    x = np.linspace(-2, 2, 9)
    path = scene_file(tmp_path, grid(x, x), box((-0.5, 1.0, -3.5), (0.5, 2, -2.5)))
    at.bake(path, tmp_path / "out.glb", "sun", lights=at.DirectionalLight((0.0, -1.0, 1.0), 20.0))
    size = 128
    seen = show(tmp_path / "out.glb", tmp_path / "out.png", size=[size, size], position=[0, 4, 1e-4], target=[0, 0, 0],
                vfov=2 * np.degrees(np.arctan(0.25)), linear=True)  # fmt: skip
    glb = Glb(tmp_path / "out.glb")
    values = glb.attribute("COLOR_0")[:, 0].reshape(9, 9)
    assert np.ptp(values) > 0.4
    pixel = (np.arange(9) - 4) * 0.5 / (2 * 4 * 0.25) * size + size / 2  # of a vertex on both axes
    inside = np.flatnonzero((pixel > 1) & (pixel < size - 1))
    shown = seen[..., 0][np.ix_(pixel[inside].astype(int), pixel[inside].astype(int))] / 255.0
    near = lambda v: np.abs(shown - v).max()
    assert near(values[np.ix_(inside, inside)].T) < 0.06  # rows of the picture are z, and pixels lie beside vertices


def test_three_shows_a_texture(tmp_path):
    """A texture of light on a floor, from straight above, against the values that the EXR holds."""
    pytest.importorskip("xatlas")
    path = scene_file(tmp_path, grid([-2, 2], [-2, 2]), box((-0.5, 1.0, -3.5), (0.5, 2, -2.5)))
    sun = at.DirectionalLight((0.0, -1.0, 1.0), 20.0)
    at.bake(path, tmp_path / "out.glb", "sun", lights=sun, texture=256, unlit=True)
    size = 96
    seen = show(tmp_path / "out.glb", tmp_path / "out.png", size=[size, size], position=[0, 4, 1e-4], target=[0, 0, 0],
                vfov=2 * np.degrees(np.arctan(0.25)), linear=True)[..., 0] / 255.0  # fmt: skip
    at_pixels = (np.arange(size) + 0.5) / size * 2 - 1
    points = np.stack(np.broadcast_arrays(at_pixels[None], 0.0, at_pixels[:, None]), -1)
    light = at.visibility(at.load(path), points, sun, normals=(0, 1, 0), spp=256).fraction * np.sqrt(0.5)
    assert np.ptp(light) > 0.6 and np.abs(seen - light).mean() < 0.01 and np.percentile(np.abs(seen - light), 95) < 0.06


def test_three_applies_the_occlusion_texture(tmp_path):
    pytest.importorskip("xatlas")
    path = scene_file(tmp_path, grid([-2, 2], [-2, 2]), box((0.2, -1.0, -3), (1.0, 3.0, 3)))
    at.bake(path, tmp_path / "out.glb", texture=256)
    view = {"size": [96, 96], "position": [0, 4, 1e-4], "target": [0, 0, 0], "vfov": 2 * np.degrees(np.arctan(0.25))}
    seen = show(tmp_path / "out.glb", tmp_path / "out.png", **view, linear=True)[48, :, 0] / 255.0
    x = (np.arange(96) + 0.5) / 96 * 2 - 1
    left = x < 0.1
    light = at.visibility(
        at.load(path),
        np.stack(np.broadcast_arrays(x[left], 0.0, 0.02), -1),
        at.AmbientOcclusion(),
        normals=(0, 1, 0),
        spp=1024,
    ).fraction
    scale = seen[left][0] / light[0]  # of the ambient light and the base colour, which is a metal's
    if scale < 0.05:
        pytest.skip("three.js shows the default material, a metal, black in ambient light")
    assert np.ptp(light) > 0.2 and np.abs(seen[left] / scale - light).max() < 0.05
