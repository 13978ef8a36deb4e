"""Measures soft shadows by plans of ours and by Embree: the same rays, in turns, in one process."""

import time
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ...kernels.parallel import thread_count
from ...methods import BUILDERS
from ...plan import Plan
from ...scene.lights import Light
from .. import views
from ..views import View, real_path, square
from .contenders import built_embree, embree_contenders, our_contender
from .contest import contest, rows
from .queries import query_of
from .ray_sets import ORDERS, shadow_rays

REAL = ("sponza_crytek",)
"""Folders of $ANTUMBRA_SCENES that are measured if they exist."""

EDGE = 40
"""The edge of a light at the place that an info.json names is the scene's diagonal divided by this."""

Say = Callable[[str], None]


class Built(NamedTuple):
    """The time of a build."""

    scene: str
    method: str
    seconds: float  # wall time; of ours, with the blocks of the tracer


def default_names() -> list[str]:
    """The scenes that are measured if none is named."""
    return [*(name for name in REAL if real_path(name)), "forest"]


def named_view(name: str, size: tuple[int, int]) -> View:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, or of a scene file."""
    return views.named_view(name, size, square(EDGE), REAL)


def measure(view: View, plan: Plan, spp: int, threads: Sequence[int], rounds: int, say: Say):
    """(the rows of `contest.rows` for each number of threads, `Built` of all builds) of a view's first light."""
    triangles = view.scene.triangles(0.0)
    vertices = triangles.vertices
    say(f"{view.name}, building")
    start = time.perf_counter()
    prepared = plan.tracer.prepare(BUILDERS[plan.build].build(vertices, None), thread_count(None))
    builds = [Built(view.name, plan.build, time.perf_counter() - start)]
    light = view.lights[0]
    query = query_of(triangles, view.camera, light, spp, thread_count(None))
    rays = shadow_rays(query)
    n, found = int(rays.asked.sum()), []
    with built_embree(vertices) as built:
        for (quality, robust), scene in built.scenes.items():
            builds.append(Built(view.name, f"Embree {quality}{' robust' * bool(robust)}", scene.build_seconds))
        for count in threads:
            contenders = [our_contender(plan, prepared, query, count)]
            contenders += embree_contenders(built, rays, ORDERS, False, count)
            tell = lambda text, count=count: say(f"{view.name}, {count} thread(s): {text}")
            results, blocked = contest(contenders, rays.asked, rounds, "wall", tell)
            case = {"scene": view.name, "triangles": len(vertices), "light": type(light).__name__, "edge": _edge(light)}
            found += rows({**case, "threads": count, "occluded": float(blocked.mean())}, results, n)
    return found, builds


def _edge(light: Light) -> float | None:
    return float(np.linalg.norm(light.u)) if hasattr(light, "u") else None


def finalists(found: Iterable[dict]) -> list[dict]:
    """The rows of ours, and of the fastest modes of Embree, which were timed in turns."""
    return [row for row in found if row["rounds"]]
