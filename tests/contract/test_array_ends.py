"""No kernel reads or writes past the end of an array, or depends on memory that nobody has written."""

import subprocess
import sys
from pathlib import Path

import pytest

SUPPORT = Path(__file__).parents[1] / "support"
PROBE = """
import sys, tempfile
from pathlib import Path
if "--guarded" in sys.argv:
    import guarded_arrays
    guarded_arrays.install()
import antumbra as at
import bits_probe

for name, digest in bits_probe.digests():
    print(name, digest)
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder, "city.antumbra")
    city = at.procedural("city", triangles=5_000)
    at.build_store(city, path, chunk=512)
    for width, height in ((48, 32), (37, 23)):
        camera = city.cameras[0].resized(width, height)
        for plan in "bsah+chcrt", "bsah+chcrt:20":
            frame = at.render(path, camera, [city.lights[0]], spp=20, plan=plan, antialias=False)
            print("store", width, plan, bits_probe.digest(*frame.bits, frame.image))
"""


def answers(*options):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-X", "faulthandler", "-c", PROBE, *options],
        cwd=SUPPORT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout.splitlines()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="arrays are guarded on Linux only: NOT checked")
def test_all_plans_and_queries_answer_the_same_with_arrays_that_end_at_a_guard():
    guarded = answers("--guarded")
    assert guarded == answers() and len(guarded) > 100
