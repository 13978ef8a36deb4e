"""Measures walkthroughs out of core: only a part of the triangles is in memory.

They are those of [Mattausch et al. 2015, Sec. 5.4, Tables 3 and 4]. The eviction policies run one after the other,
because each may fill the memory. The system may still cache pages that the second one reads.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from math import inf
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ...engine.paged_scene import PagedScene
from ...engine.paged_source import Paged
from ...errors import InputError
from ...query.light_samples import light_samples
from ...query.ray_passes import diffuse_passes
from ...rendering.memory import PASS_BYTES, frame_memory
from ...rendering.options import RenderOptions
from ...rendering.render_jobs import warm_up, warm_up_indirect
from ...rendering.renderer import Renderer
from ...rendering.request import Request
from ...scene.camera import Camera
from ...scene.lights import AmbientOcclusion
from ...techniques.chcrt.chc_rt import ChcRtState
from ..answers import digest
from .measure import CHCRT, Pace, Say, Turn, begin, bled, error_of, told_by
from .rays import DIFFUSE, KINDS, PASSES, SAMPLER, SPP, Culling, FrameRays, asked_of, timed
from .variants import THRESHOLDS, tracer_name
from .views import Walk, WalkPlace

Digests = list[tuple[str, bytes]]
"""(question, digest) of all answers, for `papers.answers.agree`."""


def out_of_core(
    place: WalkPlace, max_memory: int | None, threads: int, pace: Pace, policies: Sequence[str], say: Say
) -> Iterator[tuple[list[Turn], Digests]]:
    """Yield (turns, digests) of each walkthrough by each eviction policy. The method of a turn is its policy."""
    for walk in place.walks:
        for policy in policies:
            with opened(place, max_memory, threads) as paged:
                paged.residency.policy = policy
                found = walk_through(place, walk, paged, policy, pace, say)
            yield found


@contextmanager
def opened(place: WalkPlace, max_memory: int | None, threads: int) -> Iterator[Paged]:
    """The store of a place, with no chunk in memory."""
    if not isinstance(place.scene, PagedScene):
        raise InputError(f"{place.name}: is not a store; name it with --scene instead of --store")
    renderer = Renderer(place.scene, None, threads, max_memory=max_memory)
    warm_up(renderer.plan, "rays")
    warm_up_indirect("rays")
    paged = renderer.source
    assert isinstance(paged, Paged)
    try:
        yield paged
    finally:
        paged.residency.close()


def aggressive(place: WalkPlace, max_memory: int | None, threads: int, pace: Pace, say: Say) -> Iterator[list[Turn]]:
    """Measure Table 4 out of core, where it matters most: diffuse rays in aggressive mode. Camera rays stay exact."""
    for walk in place.walks:
        pictures: list[np.ndarray] = []
        for threshold in THRESHOLDS:
            with opened(place, max_memory, threads) as paged:
                found = _bleed_through(place, walk, paged, threshold, pictures, pace, say)
            yield found


def _bleed_through(
    place: WalkPlace, walk: Walk, paged: Paged, threshold: int, pictures: list[np.ndarray], pace: Pace, say: Say
) -> list[Turn]:
    """The turns of one threshold.

    Threshold 0 appends the picture of each frame to `pictures`. Other thresholds compare their pictures with these, in
    the same frames.
    """
    exact, threads = paged.accelerated.prepared, paged.threads
    by = ChcRtState(exact.parts, exact.options._replace(threshold=threshold))
    name = tracer_name(threshold)
    seeing, method = Culling(CHCRT, exact, threads), Culling(name, by, threads)
    turns: list[Turn] = []
    pace = pace._replace(limit=inf) if threshold else pace
    frames = pace.along(walk, f"{place.name}, {walk.name}, {name}", say)
    for frame, camera in islice(frames, len(pictures) if threshold else None):
        paged.begin(frame_memory(_request(place, camera)))
        begin([seeing, method])
        surfaces = paged.look(camera)
        asked = asked_of(place, camera, surfaces, SAMPLER, threads)
        by.room = exact.room
        before, told, seconds, met = paged.residency.paging, told_by(method), 0.0, []
        passes, each = list(asked.questions(DIFFUSE)), PASS_BYTES * camera.width * camera.height
        for first in range(0, len(passes), n := paged.together(each)):
            began = perf_counter()
            for found in paged.nearest(passes[first : first + n], asked.shape, by):
                seconds += perf_counter() - began
                met.append((found.triangles.colour, found.gbuffer.face))
                began = perf_counter()
        moved = _moved(before, paged)
        picture = bled(surfaces, met)
        pictures += [] if threshold else [picture]
        error = error_of(pictures[frame], picture) if threshold else None
        where = place.name, walk.name, SAMPLER, DIFFUSE, name, frame
        turns.append(Turn(*where, asked.rays(DIFFUSE), seconds, {**told(), **moved}, 0, error))
        del surfaces, asked, passes, met, found  # the next frame has their memory
    return turns


def _request(place: WalkPlace, camera: Camera) -> Request:
    """A frame with the rays of the benchmark."""
    lights = [AmbientOcclusion(place.reach), place.light]
    samples = [light_samples(lights[0], PASSES, SAMPLER), light_samples(lights[1], SPP)]
    return Request(camera, lights, RenderOptions(), samples, passes=diffuse_passes([place.light], PASSES, SAMPLER))


def _moved(before: NamedTuple, paged: Paged) -> dict[str, int]:
    """The paging counts since `before`."""
    after = paged.residency.paging
    return {name: b - a for name, a, b in zip(after._fields, before, after)}


def walk_through(
    place: WalkPlace, walk: Walk, paged: Paged, name: str, pace: Pace, say: Say
) -> tuple[list[Turn], Digests]:
    """(turns of all kinds of rays, digests of their answers) of a walkthrough; `name`: the method of the turns."""
    threads = paged.threads
    method = Culling(name, paged.accelerated.prepared, threads)
    turns: list[Turn] = []
    digests: Digests = []
    for frame, camera in pace.along(walk, f"{place.name}, {walk.name}, {name}", say):
        paged.begin(frame_memory(_request(place, camera)))
        method.together = paged.together(PASS_BYTES * camera.width * camera.height)
        begin([method])
        asked: FrameRays | None = None
        for kind in KINDS:
            before, told = paged.residency.paging, told_by(method)
            if asked is None:  # the time of camera rays includes making the surfaces, whose triangles are in the chunks
                began = perf_counter()
                surfaces = paged.look(camera)
                seconds = perf_counter() - began
                arrays = [surfaces.ids, surfaces.gbuffer.depth]
                asked = asked_of(place, camera, surfaces, SAMPLER, threads)
            else:
                seconds, found = timed(method, asked, kind)
                arrays = [a for answer in found for a in answer]
            moved = _moved(before, paged)
            digests.append((f"{walk.name}, {frame}, {kind}", digest(arrays)))
            where = place.name, walk.name, SAMPLER, kind, name, frame
            turns.append(Turn(*where, asked.rays(kind), seconds, {**told(), **moved}, 0))
    return turns, digests


def hit_rate(turns: list[Turn]) -> float:
    """The share of requested chunks that were in memory."""
    wanted = sum(t.told["wanted"] for t in turns)
    return sum(t.told["cached"] for t in turns) / wanted if wanted else 1.0
