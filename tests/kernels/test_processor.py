"""The same bits from every level of processors that this machine can run."""

import json
import os
import subprocess
import sys

import pytest

from antumbra.kernels.processor import X86, level, usable

HERE = usable(level())
RENDER = """
import hashlib, json, sys
import numpy as np
import antumbra as at

scene = at.procedural("atrium", triangles=3_000)
lights = [at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2)), at.SphereLight((2, 3, 1), 0.4), at.AmbientOcclusion(2.0)]
camera = scene.cameras[0].resized(72, 48)
points = np.random.default_rng(1).uniform(-4, 4, (500, 3)) + (0, 4, 0)
digests = {}
for plan in sys.argv[1:]:
    frame = at.render(scene, camera, lights, spp=16, plan=plan)
    assert all(0.0 < v.mean() < 1.0 for v in frame.visibility)
    seen = at.visibility(scene, points, lights[0], spp=64, plan=plan)
    arrays = [*frame.visibility, frame.image, seen.bits]
    digests[plan] = [hashlib.sha256(np.ascontiguousarray(a).tobytes()).hexdigest() for a in arrays]
rays = points, np.random.default_rng(2).normal(size=(500, 3))
hit = scene.closest_hit(*rays)
digests["rays"] = [hashlib.sha256(a.tobytes()).hexdigest() for a in (scene.occluded(*rays), *hit)]
print(json.dumps(digests))
"""
PLANS = [
    "bsah+multifrusta", "bsah+packet16", "bsah+wide", "bsah+single", "cones", "bsah+chcrt", "grid32+lbvh+multifrusta",
    "tl-lbvh+reinsert+packet256",
]  # fmt: skip


def rendered(processors):
    environment = dict(os.environ, ANTUMBRA_LEVEL=processors)
    command = [sys.executable, "-c", RENDER, *PLANS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
@pytest.mark.skipif(len(HERE) < 2, reason=f"this machine runs only {HERE[0]}")
def test_all_levels_give_the_same_bits():
    found = {each: rendered(each) for each in HERE}
    assert all(found[each] == found[HERE[0]] for each in HERE)
    # Different plans agree too.
    assert len({tuple(digests) for plan, digests in found[HERE[0]].items() if plan != "rays"}) == 1


def test_a_level_that_the_machine_lacks_is_refused():
    lacking = next((each for each in reversed(X86) if each not in HERE), "aarch64")
    environment = dict(os.environ, ANTUMBRA_LEVEL=lacking)
    command = [sys.executable, "-m", "antumbra", "render", "--quiet"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert f"ANTUMBRA_LEVEL is {lacking}" in done.stderr and HERE[-1] in done.stderr
