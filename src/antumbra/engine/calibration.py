"""Calibration of the cost model of the plan `auto` on this machine, in some seconds; ``antumbra warmup`` runs it."""

from collections.abc import Callable
from functools import partial
from statistics import geometric_mean
from time import process_time, thread_time

import numpy as np
from numpy.typing import NDArray

from ..bvh.nodes import Bvh
from ..kernels.parallel import thread_count
from ..query.light_samples import light_samples
from ..query.shadow_query import ShadowQuery, ray_count, shadow_queries
from ..scene.camera import Camera
from ..scene.lights import AmbientOcclusion, DirectionalLight, PointLight, QuadLight
from ..scene.triangles import Triangles
from ..trace.tracer import Form
from .auto.cost_model import BEST, GOOD, GUIDED, QUICK, MachineRates, cost_of, store_machine_rates, strategies
from .auto.strategies import TreeForms, answer_query
from .auto_accelerator import best_tree
from .method_registry import BUILDERS
from .primary_visibility import primary_visibility
from .scene import procedural

_GUIDED_COST = 1.15  # of building a GUIDED tree per triangle, relative to a GOOD one
TRIANGLES, SIZE = 60_000, (160, 128)
_SPP, _REPETITIONS = 16, 2


def calibrate(triangles: int = TRIANGLES, size: tuple[int, int] = SIZE) -> MachineRates:
    """Measure the rates of all strategies and the times to build trees, and store them beside the kernels.

    triangles, size : of the scene, and of its picture in pixels
    """
    threads = thread_count(None)
    forms, queries, vertices = small_queries(triangles, size)
    n = len(vertices)
    builds = {name: 1e9 * _seconds(partial(BUILDERS[name].build, vertices, threads)) / n for name in (QUICK, GOOD)}
    builds[GUIDED] = _GUIDED_COST * builds[GOOD]
    builds[BEST] = 1e9 * _seconds(lambda: best_tree(vertices, threads)) / n
    form_times = {
        name: 1e9 * _form_seconds(tracer.form, forms.bvh, threads) / n
        for name, tracer in strategies().items()
        if tracer.form.make is not None
    }
    slower = {name: time / (cost_of(name).reference or time) for name, time in ray_times(forms, queries).items()}
    rates = MachineRates(slower, form_times, builds)
    store_machine_rates(rates)
    return rates


def ray_times(forms: TreeForms, queries: list[ShadowQuery]) -> dict[str, float]:
    """Tracer -> nanoseconds per ray on one thread, the geometric mean over the queries that suit it.

    Without the tracers whose cost has no reference.
    """
    means = {}
    for name, tracer in strategies().items():
        suited = [query for query in queries if tracer.suits(query, forms.extent.box)]
        if cost_of(name).reference is None or not suited:
            continue
        rays = [ray_count(query) for query in suited]
        times = [_seconds(partial(answer_query, name, forms, query, 1), thread_time) for query in suited]
        means[name] = geometric_mean(1e9 * seconds / n for seconds, n in zip(times, rays))
    return means


def small_queries(
    triangles: int = TRIANGLES, size: tuple[int, int] = SIZE
) -> tuple[TreeForms, list[ShadowQuery], NDArray[np.float32]]:
    """The tree, the queries and the vertices of `calibrate`."""
    scene = procedural("atrium", triangles=triangles)
    moment = scene.triangles(0.0, 1)
    bvh = BUILDERS[QUICK].build(moment.vertices, 1)
    return TreeForms(bvh, 1), _queries(moment, scene.cameras[0].resized(*size), 1), moment.vertices


def _queries(triangles: Triangles, camera: Camera, threads: int) -> list[ShadowQuery]:
    """Queries of one scene for several kinds of light."""
    overhead = np.array([0.0, 7.0, 0.0])
    lights = [
        QuadLight(overhead, np.array([1.0, 0, 0]), np.array([0, 0, 1.0])),
        DirectionalLight(np.array([0.3, -1.0, 0.2])),
        PointLight(overhead),
        AmbientOcclusion(),
    ]
    gbuffer = primary_visibility(triangles, camera, None, threads)
    return shadow_queries(triangles, gbuffer, lights, [light_samples(light, _SPP) for light in lights], 0, threads)


def _form_seconds(form: Form, bvh: Bvh, threads: int) -> float:
    return _seconds(lambda: TreeForms(bvh, threads).of(form))


def _seconds(work: Callable[[], object], clock: Callable[[], float] = process_time) -> float:
    """The shortest of `_REPETITIONS` measured times, in seconds."""
    times = []
    for _ in range(_REPETITIONS):
        start = clock()
        work()
        times.append(clock() - start)
    return min(times)
