"""Digests of what must have the same bits on every processor level, system and Python.

Run it as a program, with the package on the path. It needs NumPy and Pillow, and prints lines of JSON: pairs of a name
and a digest. `scripts/cross_bits.py` and `tests/kernels/test_processor.py` compare them.

``--threads N`` asks from N threads at once; their answers must agree. ``--image FILE`` takes the kernels from an image
of another system's library, beside whose list it is.
"""

import hashlib
import json
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.engine.method_registry import BUILDERS, CULLERS, OPTIMISERS, TRACERS, own_methods
from antumbra.kernels import elementary
from antumbra.picture.image_files import to_srgb8
from antumbra.query.light_samples import SAMPLERS, light_samples
from foreign_library import install

LIGHTS = {
    "point": at.PointLight((0, 6, 0)),
    "quad": at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2)),
    "disk": at.DiskLight((0, 7, 0), (0.2, -1, 0.1), 0.7),
    "sphere": at.SphereLight((2, 3, 1), 0.4),
    "sun": at.DirectionalLight((-0.4, -1, -0.3)),
    "ambient": at.AmbientOcclusion(2.0),
    "sky": at.Sky(turn=31.0),
}


def digest(*arrays):
    """A digest of arrays: shapes, types and bytes."""
    found = hashlib.sha256()
    for array in map(np.ascontiguousarray, arrays):
        found.update(f"{array.shape} {array.dtype.str}".encode() + array.tobytes())
    return found.hexdigest()[:16]


def plans():
    """A plan for each method, and some of several methods."""
    out = [f"bsah+{tracer}" for tracer, method in TRACERS.items() if method.builds and tracer in own_methods("trace")]
    out += [tracer for tracer, method in TRACERS.items() if not method.builds and tracer in own_methods("trace")]
    out += [f"{builder}+multifrusta" for builder in BUILDERS if builder in own_methods("build")]
    out += [f"bsah+{each}+multifrusta" for each in OPTIMISERS if each in own_methods("optimise")]
    out += [f"{each}+bsah+multifrusta" for each in list(CULLERS)[-1:]]
    return [plan for plan in dict.fromkeys(out) if plan != "bsah+auto"]


def functions():
    """Elementary functions at many arguments."""
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(2, 100_000)) * 10.0 ** rng.uniform(-8, 3, (2, 100_000))
    for name in ("sin", "cos", "tan", "atan", "asin", "acos", "exp", "exp2", "log1p"):
        yield (
            f"functions {name}",
            lambda name=name: digest(getattr(elementary, name)(np.clip(x, -1, 1) if name[0] == "a" else x)),
        )
    yield "functions log", lambda: digest(elementary.log(np.abs(x)), elementary.log2(np.abs(x)))
    yield "functions atan2", lambda: digest(elementary.atan2(y, x))
    yield "functions power", lambda: digest(elementary.power(np.abs(x), np.minimum(np.abs(y), 8.0) + 0.1))


def scenes():
    """Procedural scenes, their cameras, and their own and default lights."""
    for name in ("atrium", "city", "forest"):
        scene = at.procedural(name, triangles=20_000)
        yield f"scene {name}", lambda scene=scene: digest(scene.triangles().vertices)
        for kind in ("perspective", "orthographic", "panoramic"):
            yield f"camera {name} {kind}", lambda scene=scene, kind=kind: camera_of(scene, kind)


def camera_of(scene, kind):
    camera = scene.cameras[0] if scene.cameras else scene.default_camera(320, 180)
    if kind == "panoramic":
        camera = camera.panoramic()
    elif kind == "orthographic":
        camera = at.Camera(
            camera.position, camera.target, camera.up, width=320, height=180, projection=kind, extent=9.0
        )
    rays = camera.view(scene.origin)
    return (
        digest(*rays.through(np.arange(camera.width)[None] + 0.5, np.arange(camera.height)[:, None] + 0.5))
        if camera.listed
        else digest(*rays)
    )


def samples():
    """Sample points of all kinds of lights, by all samplers that need no extra."""
    for name, light in LIGHTS.items():
        for sampler in [each for each in SAMPLERS if each != "sobol"]:
            yield f"samples {name} {sampler}", lambda a=light, b=sampler: digest(light_samples(a, 64, b))
        if name not in ("sky", "ambient"):
            yield f"patch {name}", lambda a=light: digest(*[np.asarray(v) for v in a.patch(np.zeros(3), 100.0)])


def questions():
    """Rays, points and pictures by all plans."""
    scene = at.procedural("atrium", triangles=20_000)
    rng = np.random.default_rng(2)
    origins, directions = rng.uniform(-6, 6, (300_000, 3)) + (0, 4, 0), rng.normal(size=(300_000, 3))
    yield "rays occluded", lambda: digest(scene.occluded(origins, directions))
    yield "rays closest hit", lambda: digest(*scene.closest_hit(origins, directions))
    yield "rays all hits", lambda: digest(*scene.all_hits(origins[:20_000], directions[:20_000]))
    yield "line of sight", lambda: digest(at.line_of_sight(scene, origins[:20_000], origins[20_000:40_000]).visible)
    small = at.procedural("atrium", triangles=3_000)
    camera = small.cameras[0].resized(72, 48)
    lights = [light for name, light in LIGHTS.items() if name != "sky"]
    for plan in plans():
        yield f"frame {plan}", lambda plan=plan: frame_of(small, camera, lights, 16, plan)
    outdoors = at.procedural("city", triangles=3_000)
    view, sun = outdoors.cameras[0].resized(70, 46), [at.DirectionalLight((-0.4, -1, -0.3)), outdoors.lights[0]]
    for plan in plans():  # pixels without a surface, and tiles beyond the picture
        yield f"outdoors {plan}", lambda plan=plan: frame_of(outdoors, view, sun, 16, plan)
    points = origins[:2_000]
    for name in [each for each in LIGHTS if each != "ambient"]:
        yield f"points {name}", lambda name=name: digest(at.visibility(small, points, LIGHTS[name], spp=64).bits)
    for name in ("atrium", "city", "forest"):
        yield f"picture {name}", lambda name=name: picture_of(name)


def jobs():
    """Results of jobs that need no extra."""
    city = at.procedural("city", triangles=20_000)
    points = np.random.default_rng(3).uniform((-60, 1, -60), (60, 20, 60), (40, 3))
    yield "skyline", lambda: digest(at.skyline(city, points).elevation)
    yield "matrix", lambda: digest(at.visibility_matrix(city, points, points).bits)
    ridge = at.from_raster((np.arange(6_000.0).reshape(60, 100) ** 2 % 97.0 / 7.0, (2.0, 0.0, 0.0, 0.0, -2.0, 0.0)))
    table = at.viewshed(ridge, "raster", (50.0, -50.0, 14.0), least_height=True).table
    yield "least heights", lambda: digest(table["least_height"], table["seen"])


def frame_of(scene, camera, lights, spp, plan="auto"):
    frame = at.render(scene, camera, lights, spp=spp, plan=plan)
    assert all(0.0 < v.mean() < 1.0 for v in frame.visibility)
    return digest(*frame.visibility, frame.image)


def picture_of(name):
    """The default picture of a scene."""
    scene = at.procedural(name, triangles=20_000)
    frame = at.render(
        scene, scene.default_camera(320, 180) if not scene.cameras else scene.cameras[0].resized(320, 180)
    )
    return digest(*frame.visibility, frame.image, to_srgb8(frame.image, 1.0))


def digests():
    """(name, digest) of all questions."""
    for group in (functions, samples, scenes, questions, jobs):
        for name, make in group():
            yield name, make()


if __name__ == "__main__":
    if "--image" in sys.argv:
        image = Path(sys.argv[sys.argv.index("--image") + 1])
        install(image, image.parent)
    threads = int(sys.argv[sys.argv.index("--threads") + 1]) if "--threads" in sys.argv else 1
    if threads > 1:
        with ThreadPoolExecutor(threads) as pool:
            answers = list(pool.map(lambda _: dict(digests()), range(threads)))
        assert all(each == answers[0] for each in answers), "threads that ask at once get different bits"
    for item in digests():
        print(json.dumps(item), flush=True)
