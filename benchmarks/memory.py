"""Memory of a loaded scene with its BVH, in bytes per triangle: array sizes, and growth of the process.

python benchmarks/memory.py [SCENE]        (default: San Miguel)
"""

import gc
import os
import sys
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.engine.plan import Plan
from common import SCENES


def resident() -> int:
    """Resident bytes of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def main() -> None:
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else SCENES / "sanmiguel_lite" / "scene.glb"
    warm = at.procedural("atrium", 20_000)
    warm.occluded((0, 0, 0), (0, 1, 0))
    del warm
    gc.collect()
    before = resident()
    scene = at.load(path)
    accelerated = scene.engine.with_options(Plan(), None, None).accelerated()
    gc.collect()
    growth = resident() - before
    fields = {name: a for part in accelerated[:3] if part is not None for name, a in part._asdict().items()}
    arrays = {name: a.nbytes for name, a in fields.items() if isinstance(a, np.ndarray) and name != "links"}
    n = scene.n_triangles
    print(f"{path}: {n} triangles")
    for name, size in arrays.items():
        print(f"  {name:10} {size / n:7.1f} bytes per triangle")
    print(f"process grew by {growth / n:.1f} bytes per triangle ({growth / 2**20:.0f} MiB)")


if __name__ == "__main__":
    main()
