"""Calibrate the cost model of the plan `auto` on this machine; ``antumbra warmup`` runs it once, for some seconds."""

from collections.abc import Callable
from functools import partial
from statistics import geometric_mean
from time import perf_counter, thread_time

import numpy as np

from ..bvh.nodes import Bvh
from ..kernels.parallel import thread_count
from ..query.light_samples import light_samples
from ..query.shadow_query import ShadowQuery, ray_count, shadow_queries
from ..scene.lights import AmbientOcclusion, DirectionalLight, PointLight, QuadLight
from ..scene.triangles import Triangles
from .accelerator import best_tree
from .auto.cost_model import BEST, GOOD, QUICK, MachineRates, reference, store_machine_rates
from .auto.strategies import STRATEGIES, TreeForms, answer_query
from .method_registry import BUILDERS
from .primary_visibility import primary_visibility
from .scene import procedural

_TRIANGLES, _SIZE, _SPP, _TIMES = 60_000, (160, 128), 16, 2


def calibrate() -> MachineRates:
    """Measure the rates of all ways, and the times to build trees; keep them beside the kernels."""
    scene, threads = procedural("atrium", triangles=_TRIANGLES), thread_count(None)
    triangles = scene.triangles(0.0, threads)
    n = len(triangles.vertices)
    builds = {
        name: 1e9 * _seconds(lambda name=name: BUILDERS[name].build(triangles.vertices, threads)) / n
        for name in (QUICK, GOOD)
    }
    builds[BEST] = 1e9 * _seconds(lambda: best_tree(triangles.vertices, threads)) / n
    bvh = BUILDERS[QUICK].build(triangles.vertices, threads)
    forms = {
        name: 1e9 * _form_seconds(name, bvh, threads) / n for name, way in STRATEGIES.items() if way.form is not None
    }
    queries = _queries(triangles, scene.cameras[0].resized(*_SIZE), threads)
    made = TreeForms(bvh, threads)
    slower = {name: of_ray / reference()[name] for name, of_ray in ray_times(made, queries).items()}
    measured = MachineRates(slower, forms, builds)
    store_machine_rates(measured)
    return measured


def ray_times(forms: TreeForms, queries: list[ShadowQuery]) -> dict[str, float]:
    """Way -> nanoseconds of one thread for a ray, on average over the queries that it can answer."""
    found = {}
    for name, way in STRATEGIES.items():
        suited = [query for query in queries if way.suits(query, forms.box)]
        rays = [ray_count(query) for query in suited]
        times = [_seconds(partial(answer_query, name, forms, query, 1), thread_time) for query in suited]
        found[name] = geometric_mean(1e9 * seconds / n for seconds, n in zip(times, rays))
    return found


def _queries(triangles: Triangles, camera, threads: int) -> list[ShadowQuery]:
    """Queries of one scene by several kinds of light."""
    over = np.array([0.0, 7.0, 0.0])
    lights = [
        QuadLight(over, np.array([1.0, 0, 0]), np.array([0, 0, 1.0])), DirectionalLight(np.array([0.3, -1.0, 0.2])),
        PointLight(over), AmbientOcclusion(),
    ]  # fmt: skip
    gbuffer = primary_visibility(triangles, camera, None, threads)
    return shadow_queries(triangles, gbuffer, lights, [light_samples(light, _SPP) for light in lights], 0, threads)


def _form_seconds(name: str, bvh: Bvh, threads: int) -> float:
    return _seconds(lambda: TreeForms(bvh, threads).of(STRATEGIES[name]))


def _seconds(work: Callable[[], object], clock: Callable[[], float] = perf_counter) -> float:
    """The least seconds of some times."""
    found = []
    for _ in range(_TIMES):
        start = clock()
        work()
        found.append(clock() - start)
    return min(found)
