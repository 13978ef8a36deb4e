"""The same walkthroughs where only a part of the triangles is in memory [Mattausch et al. 2015, Sec. 5.4, Table 3].

The policies come one after the other, since each may fill the memory; what the second reads, the system may still have.
"""

from time import perf_counter

from ..errors import InputError
from ..paged import Paged, is_paged
from ..renderer import Renderer
from ..store.residency import POLICIES
from ..warm import warm_up, warm_up_indirect
from .answers import digest
from .chcrt import Pace, Say, Turn, begin, told_by
from .chcrt_rays import KINDS, SAMPLER, SPP, Asked, Culling, asked_of, timed
from .chcrt_views import Place, Walk


def out_of_core(
    place: Place, max_memory: int | None, threads: int, pace: Pace, say: Say
) -> tuple[list[Turn], list[tuple[str, bytes]]]:
    """(the turns of both policies, which are their methods; (frame, digest) of all answers)."""
    if not is_paged(place.scene):
        raise InputError(f"{place.name}: is not a store; name it with --scene instead of --store")
    turns, digests = [], []
    for walk in place.walks:
        for policy in POLICIES:
            renderer = Renderer(place.scene, None, threads, max_memory=max_memory)
            warm_up(renderer.plan, "rays")
            warm_up_indirect(renderer.plan, "rays")
            assert renderer.paged is not None
            renderer.paged.residency.policy = policy
            try:
                found = _walk_through(place, walk, renderer.paged, pace, say)
            finally:
                renderer.paged.residency.close()
            turns += found[0]
            digests += found[1]
    return turns, digests


def _walk_through(place: Place, walk: Walk, paged: Paged, pace: Pace, say: Say):
    """The turns of one policy, and digests of its answers."""
    policy, threads = paged.residency.policy, paged.threads
    method = Culling(policy, paged.accelerated.prepared, threads)
    turns: list[Turn] = []
    digests: list[tuple[str, bytes]] = []
    start = perf_counter()
    for frame in range(pace.frames):
        if frame > 1 and perf_counter() - start > pace.limit:
            break
        say(f"{place.name}, {walk.name}, {policy}, frame {frame + 1} of {pace.frames}")
        camera = walk.camera(frame, pace.frames)
        paged.begin(camera.width * camera.height, -(-SPP // 64))
        begin([method])
        asked: Asked | None = None
        for kind in KINDS:
            before, told = paged.residency.paging, told_by(method)
            if asked is None:  # of the camera's rays: with the surfaces, whose triangles are in the chunks
                began = perf_counter()
                surfaces = paged.look(camera)
                seconds = perf_counter() - began
                arrays = [surfaces.ids, surfaces.gbuffer.depth]
                asked = asked_of(place, camera, surfaces, SAMPLER, threads)
            else:
                seconds, found = timed(method, asked, kind)
                arrays = [a for answer in found for a in answer]
            after = paged.residency.paging
            moved = {name: b - a for name, a, b in zip(after._fields, before, after)}
            digests.append((f"{walk.name}, {frame}, {kind}", digest(arrays)))
            where = place.name, walk.name, SAMPLER, kind, policy, frame
            turns.append(Turn(*where, asked.rays(kind), seconds, {**told(), **moved}, 0))
    return turns, digests


def hit_rate(turns: list[Turn]) -> float:
    """The share of the chunks that were wanted, and were in memory."""
    wanted = sum(t.told["wanted"] for t in turns)
    return sum(t.told["cached"] for t in turns) / wanted if wanted else 1.0
