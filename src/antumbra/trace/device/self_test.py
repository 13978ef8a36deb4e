"""The self-test of a device: rays that are hard to decide, on the first use of a card, compared with the CPU's answers.

A driver's compiler may be wrong, and a card may be faulty. So the first time that a card, its driver and our kernels
meet, they answer a few thousand queries: rays through vertices and along edges, in the planes of triangles, of all
directions and lengths. Every kernel takes part. A pass is remembered in the user's cache; a failure is an error.
"""

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from hashlib import blake2b
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...base.files import make_folder
from ...bvh import lbvh, ploc
from ...bvh.binned_sah import build
from ...bvh.instance_trees import InstanceTrees
from ...bvh.nodes import LINK, Bvh
from ...bvh.refit import refit
from ...bvh.tree_quality import sah_cost
from ...bvh.wide_bvh import widen
from ...devices.arrays import DeviceArray
from ...devices.device import Device, DeviceError
from ...devices.device_list import open_device
from ...kernels.toolchain.device_code import Form
from ...kernels.toolchain.kernel_cache import cache_root
from ...query.gbuffer import from_hits
from ...query.light_samples import light_samples
from ...query.ray_list import HitArrays, RayArguments, hit_arrays, segments_between
from ...query.ray_passes import rays_through
from ...query.receivers import FREE, surface_receivers
from ...query.shadow_query import ShadowQuery, new_bits, with_receivers
from ...scene.alpha_masks import AlphaMask, cutouts_of
from ...scene.camera import Camera
from ...scene.instance_data import InstanceData
from ...scene.instances import InstancedMeshes
from ...scene.lights import Light, QuadLight, SphereLight
from ...scene.materials import CLAMP, MIRROR, REPEAT
from ...scene.mesh import Mesh
from ...scene.triangle_setup import survey
from ...scene.triangles import Triangles
from ..alpha_cutouts import CutoutTree, add_hits, add_shadows, tree_of_cutouts
from ..rays.instance_batches import trace_list
from ..rays.instance_rays import InstanceForest
from ..rays.ray_batches import RayTracer
from ..rays.ray_hits import nearest_hits
from ..rays.single_rays import as_built, trace_shadow
from ..transmission import shares_of
from ..tree_list import no_hits
from .device_instances import ForestTracer
from .device_kernels import KERNELS
from .device_launches import DeviceLaunches
from .device_rasteriser import draw_surfaces
from .device_stages import CAPACITIES, Capacities
from .device_surfaces import see_surfaces
from .device_tracer import BUILDERS, DeviceTracer
from .nearest_list_tracer import RayGrid, RayVectors, TiledRays
from .part_trees import part_tree
from .resident_vertices import ResidentVertices
from .tree_build import source_of
from .tree_list_tracer import TiledTracer, TileLayout, TreeLists, set_bits

_SEED, _RAYS, _RECEIVERS, _SPP = 62, 2000, 512, 4
_PIXELS = 40, 50  # of _RAYS
_FRAME = 0.0, 0.0, 0.0
_CAPACITIES = CAPACITIES, Capacities(512, 256, 64), Capacities(256, 256, 1 << 20)
"""Lists of the usual size; lists that overflow, so that rays are traced again; and by the CPU."""


# --- Cases ------------------------------------------------------------------------------------------------------------


def _triangles(rng: np.random.Generator) -> NDArray[np.float32]:
    """(n, 3, 3) float32: triangles at whole coordinates, some twice; a height field; loose ones, slivers; far ones."""
    grid = rng.integers(-3, 4, (30, 3, 3))
    x, z = np.meshgrid(np.arange(-4.0, 5), np.arange(-4.0, 5))
    points = np.stack([x, rng.uniform(-5, -4, x.shape), z], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    field = np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2).reshape(-1, 3, 3)
    loose = rng.uniform(-20, 20, (150, 1, 3)) + rng.normal(0, 1, (150, 3, 3))
    loose[:50, 2] = loose[:50, 0] + 0.7 * (loose[:50, 1] - loose[:50, 0]) + rng.normal(0, 1e-3, (50, 3))
    far = rng.normal(0, 1e4, (20, 1, 3)) + rng.normal(0, 1e3, (20, 3, 3))
    return np.concatenate([grid, grid[:5], field, loose, far]).astype(np.float32)


def _aims(
    rng: np.random.Generator, vertices: NDArray[np.float32], n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """((n, 3) points, (n, 3) directions in their planes): vertices, points on edges, within triangles, and beside them.

    Once rounded to float32, most of them lie some bits beside an edge.
    """
    chosen = vertices[rng.integers(0, len(vertices), n)].astype(np.float64)
    weights = rng.integers(0, 9, (n, 3)) / 8.0
    weights[0::4] = 1, 0, 0
    weights[1::4, 2] = rng.choice([0, 1e-7, -1e-7], len(weights[1::4]))
    weights[2::4, :2] = rng.uniform(0, 0.5, weights[2::4, :2].shape)
    weights[:, 0] = 1 - weights[:, 1] - weights[:, 2]
    along = rng.normal(size=(n, 2))
    p, q = chosen[:, 1] - chosen[:, 0], chosen[:, 2] - chosen[:, 0]
    return np.einsum("nk,nkc->nc", weights, chosen), along[:, :1] * p + along[:, 1:] * q


def _lines(rng: np.random.Generator, vertices: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """(origins, ends), (_RAYS, 3) float32 each, through aims: short ones that meet little else, and long ones."""
    aims, in_plane = _aims(rng, vertices, _RAYS)
    along = rng.normal(size=(_RAYS, 3))
    along[::6] = in_plane[::6]
    along[1::6] = np.eye(3)[rng.integers(0, 3, len(along[1::6]))]
    along[2::6] = rng.integers(-3, 4, along[2::6].shape) / 4
    along *= np.where(rng.random((_RAYS, 1)) < 0.1, 20.0, 1.0)
    along[~along.any(1)] = 1
    origins = (aims + along).astype(np.float32)
    ends = (aims - along * rng.choice([0.0, 1e-6, 0.5, 1.0, 2.0], (_RAYS, 1))).astype(np.float32)
    ends[(ends == origins).all(1)] += 1
    return origins, ends


def _segments(rng: np.random.Generator, vertices: NDArray[np.float32]) -> RayArguments:
    (origins, ends), skip = _lines(rng, vertices), rng.integers(-1, len(vertices), _RAYS)
    return segments_between(origins, ends, np.where(rng.random(_RAYS) < 0.5, skip, -1), 0.0)


def _rays(rng: np.random.Generator, vertices: NDArray[np.float32], cull_faces: int) -> RayArguments:
    origins, ends = _lines(rng, vertices)
    scale = np.where(rng.random((_RAYS, 1)) < 0.5, 1.0, 10.0 ** rng.integers(-6, 7, (_RAYS, 1)))
    directions = ((ends - origins) * scale).astype(np.float32)
    tmin = np.where(rng.random(_RAYS) < 0.5, 0.0, rng.uniform(0, 1, _RAYS) / scale[:, 0])
    tmax = np.where(rng.random(_RAYS) < 0.5, np.inf, tmin + rng.uniform(0, 3, _RAYS) / scale[:, 0])
    return RayArguments(origins, directions, tmin, tmax, -1.0, (_RAYS,), cull_faces, False, _FRAME)


def _query(
    origins: NDArray[np.float32],
    light: Light,
    faces: NDArray[np.int32],
    sides: NDArray[np.int8],
    corners: NDArray[np.float32],
) -> ShadowQuery:
    """The query of receivers in a row; faces, sides, corners: as in `ShadowQuery`."""
    patch, samples, own = light.patch(np.zeros(3), 1e5), light_samples(light, _SPP), faces[None]
    return ShadowQuery(origins[None], own, sides[None], np.empty((0, 0, 3)), corners, patch, samples, 0, own)


def _floating_query(rng: np.random.Generator, vertices: NDArray[np.float32]) -> ShadowQuery:
    """Receivers in space, behind the edges that one of their samples of a quad meets."""
    light = QuadLight((-3, 9, 5), (6, 1, 0), (0, 2, -10))
    samples = light_samples(light, _SPP)
    own = samples[np.arange(_RECEIVERS) & 3, rng.integers(0, _SPP, _RECEIVERS)]
    places = light.corner + own[:, :1] * light.u + own[:, 1:2] * light.v
    aims, _ = _aims(rng, vertices, _RECEIVERS)
    origins = (aims + (aims - places) * rng.uniform(0.01, 0.1, (_RECEIVERS, 1))).astype(np.float32)
    faces, sides = np.full(_RECEIVERS, -1, np.int32), np.full(_RECEIVERS, FREE, np.int8)
    return _query(origins, light, faces, sides, np.empty((0, 9), np.float32))


def _surface_query(rng: np.random.Generator, vertices: NDArray[np.float32]) -> ShadowQuery:
    """Receivers on triangles, close to their edges, below a sphere."""
    edges = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0]).astype(np.float64)
    length = np.linalg.norm(edges, axis=1)
    faces = rng.choice(np.flatnonzero(length > 0), _RECEIVERS).astype(np.int32)
    sides = rng.choice(np.array([-1, 1], np.int8), _RECEIVERS)
    normals = (edges[faces] / length[faces, None] * sides[:, None]).astype(np.float32)
    weights = rng.dirichlet((0.3, 0.3, 0.3), _RECEIVERS).astype(np.float32)
    corners = np.ascontiguousarray(vertices.reshape(-1, 9))
    positions = np.einsum("nk,nkc->nc", weights, vertices[faces])
    origins = surface_receivers(positions, normals, faces, sides, corners, 1)
    return _query(origins, SphereLight((0, 2, 0), 2.0), faces, sides, corners)


class _Cases(NamedTuple):
    """Queries, and the CPU's answers in the order of `_answers`."""

    bvh: Bvh
    vertices: NDArray[np.float32]  # (n, 3, 3) float32: its triangles
    moved: NDArray[np.float32]  # (n, 3, 3) float32: the triangles at another moment
    segments: RayArguments
    rays: list[RayArguments]
    queries: list[ShadowQuery]
    answers: list[NDArray[np.generic]]


@cache
def _cases() -> _Cases:
    rng = np.random.default_rng(_SEED)
    vertices = _triangles(rng)
    bvh = build(vertices, 1)
    moved = (vertices + rng.integers(-1, 2, (len(vertices), 1, 3))).astype(np.float32)
    rays = [_rays(rng, vertices, cull_faces) for cull_faces in (0, 1)]
    cases = _Cases(
        bvh,
        vertices,
        moved,
        _segments(rng, vertices),
        rays,
        [make(rng, vertices) for make in (_floating_query, _surface_query)],
        [],
    )
    return cases._replace(answers=list(_cpu_answers(cases)))


def _cpu_answers(cases: _Cases) -> Iterator[NDArray[np.generic]]:
    """The answers of the CPU's tracers, as `_answers` orders those of a device."""
    for bvh in cases.bvh, refit(cases.bvh, cases.moved, 1):
        tracer = RayTracer(widen(bvh, 1))
        for rays, any_hit in _lists(cases):
            hits = hit_arrays(rays.n, any_hit)
            if not tracer.trace(rays, any_hit, hits, 1):
                raise AssertionError("a ray of the self-test is invalid")
            yield from _columns(hits, any_hit)
        for query, _ in _shadows(cases):
            bits = new_bits(query)
            trace_shadow(as_built(bvh), query, bits, 1)
            yield bits


def _lists(cases: _Cases) -> Iterator[tuple[RayArguments, bool]]:
    """(rays, whether any hit is asked for)."""
    yield cases.segments, True
    for rays in cases.rays:
        yield rays, True
        yield rays, False


def _shadows(cases: _Cases) -> Iterator[tuple[ShadowQuery, bool]]:
    """(query, whether shafts trace it): receivers in a row; a quarter as a picture, whose tiles share few triangles."""
    for query in cases.queries:
        yield query, False
        yield with_receivers(query, partial(_pictured, np.argsort(query.ids[0], kind="stable")[::4])), True


def _pictured(order: NDArray[np.int64], receivers: NDArray[Any]) -> NDArray[Any]:
    """(8, n, ...): some of the receivers in a row, as pixels."""
    return receivers[:, order].reshape(8, -1, *receivers.shape[2:])


def _columns(hits: HitArrays, any_hit: bool) -> tuple[NDArray[np.generic], ...]:
    return (hits.blocked,) if any_hit else tuple(hits[1:])


# --- The test ---------------------------------------------------------------------------------------------------------


class SelfTest(NamedTuple):
    """The result of a self-test."""

    answers: int
    wrong: int  # those that differ from the CPU's


def run_self_test(device: Device) -> SelfTest:
    """Let a device answer all queries, with lists of all sizes, and build trees; compare its bits with the CPU's."""
    cases, answers, wrong = _cases(), 0, 0
    for found, expected in chain.from_iterable(compare(device) for compare in COMPARISONS):
        answers += expected.size
        wrong += expected.size if found.shape != expected.shape else int(np.count_nonzero(found != expected))
    for capacities in _CAPACITIES:
        for found, expected in zip(_answers(device, cases, capacities), cases.answers, strict=True):
            answers += expected.size
            wrong += int(np.count_nonzero(found != expected))
    return SelfTest(answers, wrong)


def _answers(device: Device, cases: _Cases, capacities: Capacities) -> Iterator[NDArray[np.generic]]:
    tracer = DeviceTracer(device, capacities)
    tree = tracer.tree(cases.bvh)
    for moved in False, True:
        if moved:
            tree.move(refit(cases.bvh, cases.moved, 1), cases.moved)
        for rays, any_hit in _lists(cases):
            yield from _columns(tracer.trace_rays(tree, rays, any_hit, 1), any_hit)
        for query, shafts in _shadows(cases):
            bits = new_bits(query)
            tracer.trace_shadow(tree, query, bits, 1, shafts=shafts)
            yield bits


# --- Trees ------------------------------------------------------------------------------------------------------------


Comparison = tuple[NDArray[Any], NDArray[Any]]
"""What a device has computed, and the same from the CPU."""


_COPIES = 16


def _crowd(vertices: NDArray[np.float32]) -> NDArray[np.float32]:
    """(_COPIES n, 3, 3) float32: copies of n triangles in a row, enough for all kernels of a build."""
    places = np.zeros((_COPIES, 1, 1, 3), np.float32)
    places[:, 0, 0, 0] = 37.0 * np.arange(_COPIES)
    return (vertices + places).reshape(-1, 3, 3)


def _compared_trees(device: Device) -> Iterator[Comparison]:
    """The parts of a tree of each builder, those of its refit, and the cost of that."""
    cases, launches = _cases(), DeviceLaunches(device)
    vertices, moved = _crowd(cases.vertices), _crowd(cases.moved)
    for name, module in ("lbvh", lbvh), ("ploc", ploc):
        tree, expected = BUILDERS[name](source_of(vertices, None, launches), launches), module.build(vertices, 1)
        yield from zip(_parts(tree.bvh), _parts(expected))
        refitted, expected = tree.refitted(moved), refit(expected, moved, 1)
        yield from zip(_parts(refitted.bvh), _parts(expected))
        yield np.array([refitted.cost()]), np.array([sah_cost(expected)])


def _parts(bvh: Bvh) -> tuple[NDArray[np.generic], ...]:
    return bvh.nodes[:, :LINK], bvh.links[:, LINK:], bvh.prim_ids, bvh.corners


def _compared_vertices(device: Device) -> Iterator[Comparison]:
    """(triangles, areas and bounds that a device finds, those of the CPU), some of them lines and points."""
    rng, tracer = np.random.default_rng(8), DeviceTracer(device)
    points = np.concatenate([rng.integers(-3, 4, (100, 3)), rng.normal(0, 5, (500, 3))]).astype(np.float32)
    corners = np.concatenate([rng.integers(0, 100, 900), rng.integers(0, 600, 2100)]).astype(np.int32)
    array = DeviceArray(device.upload(points), points.shape, points.dtype, device.queue)
    framed = ResidentVertices(tracer, array).in_frame(corners, np.array([0.25, 1.0, -2.0]), "the self-test")
    expected = (points.astype(np.float64) - [0.25, 1.0, -2.0]).astype(np.float32)[corners].reshape(-1, 3, 3)
    with_area, bounds = survey(expected, 1)
    assert with_area is not None and framed.with_area is not None
    yield from ((framed.fetch(), expected), (framed.with_area, with_area), (framed.bounds, bounds))


def _compared_surfaces(device: Device) -> Iterator[Comparison]:
    """The surfaces that a camera sees, and the receivers on them."""
    cases, shape = _cases(), (48, 64)
    numbers = np.arange(len(cases.vertices), dtype=np.int32)
    triangles = Triangles(cases.vertices, np.zeros(3), numbers, np.ones((len(numbers), 3), np.float32))
    rays = Camera((1, 1, 7), (0, -3, 0), width=shape[1], height=shape[0]).rays(triangles.origin)
    face, t = nearest_hits(cases.bvh, *rays_through(rays, np.ones(shape, np.bool_), 1), 1)
    seen = from_hits(face.reshape(shape), t.reshape(shape), triangles, rays, 1)
    flat = seen.position.reshape(-1, 3), seen.normal.reshape(-1, 3), face, seen.side.reshape(-1)
    origins = surface_receivers(*flat, cases.vertices.reshape(-1, 9), 1).reshape(*shape, 3)
    for capacities in _CAPACITIES:
        tracer = DeviceTracer(device, capacities)
        drawn = draw_surfaces(tracer, triangles, rays, None, 1)
        assert drawn is not None
        for found in see_surfaces(tracer, tracer.tree(cases.bvh), triangles, rays, None, 1), drawn:
            yield from ((getattr(found, name), getattr(seen, name)) for name in ("position", "normal", "depth", "side"))
            yield from ((found.face, seen.face), (found.origins, origins))
        drawn.wide_normals()
        normals = tracer.launches.block("normals", 0, "").read(np.empty((*shape, 3)))
        yield normals, seen.normal.astype(np.float64)


def _masked() -> tuple[Bvh, CutoutTree]:
    """(solid triangles, cut-outs) of the scene: half of the faces have holes, or are coloured panes."""
    rng, vertices = np.random.default_rng(58), _cases().vertices
    holes = AlphaMask((rng.random((16, 16)) < 0.5).astype(np.uint8), np.array([[1.0] * 3, [0.0] * 3]), (REPEAT, MIRROR))
    pane = AlphaMask(np.zeros((1, 1), np.uint8), np.array([[0.9, 0.6, 0.3]]), (CLAMP, CLAMP))
    uv = rng.uniform(-2, 3, (len(vertices), 3, 2)).astype(np.float32)
    cutouts = cutouts_of(uv, rng.choice(np.array([-1, -1, 0, 1], np.int32), len(vertices)), [holes, pane])
    assert cutouts is not None
    solid = build(vertices[cutouts.solid], 1)
    tree = tree_of_cutouts(cutouts, vertices[cutouts.faces], vertices.reshape(-1, 9), 1)
    return solid._replace(prim_ids=cutouts.solid[solid.prim_ids]), tree


def _compared_cutouts(device: Device) -> Iterator[Comparison]:
    """Hits on faces with holes and panes, and the light that passes through them."""
    cases, (solid, cutouts) = _cases(), _masked()
    wide, answers = RayTracer(widen(solid, 1)), []
    for rays, any_hit in _lists(cases):
        hits = hit_arrays(rays.n, any_hit)
        wide.trace(rays, any_hit, hits, 1)
        add_hits(cutouts, rays.arrays(), rays.cull_faces, any_hit, hits, 1)
        answers.append(hits)
    for capacities in _CAPACITIES:
        tracer = DeviceTracer(device, capacities)
        tree = tracer.tree(solid)
        for (rays, any_hit), hits in zip(_lists(cases), answers, strict=True):
            found = tracer.trace_rays(tree, rays, any_hit, 1, cutouts)
            yield from zip(_columns(found, any_hit), _columns(hits, any_hit), strict=True)
        for query in cases.queries:
            bits = new_bits(query)
            tracer.trace_shadow(tree, query, bits, 1)
            with_cutouts = bits.copy()
            tracer.add_shadows(cutouts, query, with_cutouts, 1)
            add_shadows(cutouts, query, bits, 1)
            yield with_cutouts, bits
            yield from zip(tracer.shares(cutouts, query, bits, 1), shares_of(cutouts, query, bits, 1), strict=True)


def _copies() -> InstanceData:
    """Turned, mirrored and sheared copies of the scene's triangles at whole coordinates, and of its height field."""
    rng, vertices = np.random.default_rng(59), _cases().vertices
    parts, matrices = (vertices[:30], vertices[35:163]), []
    for n in 6, 3:
        linear = np.where(rng.random((n, 1, 1)) < 0.5, rng.integers(-1, 2, (n, 3, 3)), rng.normal(size=(n, 3, 3)))
        matrix = np.concatenate([linear + 3.0 * np.eye(3), rng.integers(-20, 20, (n, 3, 1))], axis=2)
        matrices.append(matrix)
    white = np.ones(3, np.float32)
    meshes = [Mesh(str(k), each.reshape(-1, 3), None, white) for k, each in enumerate(parts)]
    return InstanceData(InstancedMeshes(meshes, matrices, "the self-test"), threads=1)


def _compared_instances(device: Device) -> Iterator[Comparison]:
    """Hits on copies, and the segments that they block."""
    rng, scene = np.random.default_rng(60), _copies()
    trees, answers = InstanceTrees(scene, build, 1), []
    flat = scene.some_triangles(np.arange(scene.n_triangles, dtype=np.int32)).vertices
    lists = [(_segments(rng, flat), True), *((_rays(rng, flat, facing), facing == 0) for facing in (0, 1))]
    for rays, any_hit in lists:
        answers.append(hit_arrays(rays.n, any_hit))
        trace_list(trees, rays, any_hit, answers[-1], 1)
    query = _floating_query(rng, flat)
    bits = new_bits(query)
    trace_shadow(InstanceForest(trees.arrays), query, bits, 1)
    for capacities in _CAPACITIES:
        tracer, found = ForestTracer(DeviceTracer(device, capacities)), new_bits(query)
        forest = tracer.forest(trees)
        for (rays, any_hit), hits in zip(lists, answers, strict=True):
            ours = tracer.trace_rays(forest, rays, any_hit, 1)
            yield from zip(_columns(ours, any_hit), _columns(hits, any_hit), strict=True)
        tracer.trace_shadow(forest, query, found, 1)
        yield found, bits


_TILE = 24
"""Side of a tile, so that the last one of a row lies partly outside."""


def _halves(cases: _Cases) -> list[Bvh]:
    """Trees of every other triangle, whose boxes overlap."""
    halves = list[Bvh]()
    for first in 0, 1:
        ids = np.arange(first, len(cases.vertices), 2, dtype=np.int32)
        bvh = build(cases.vertices[ids], 1)
        halves.append(bvh._replace(prim_ids=ids[bvh.prim_ids]))
    return halves


def _compared_lists(device: Device) -> Iterator[Comparison]:
    """Segments that triangles in several trees block, tile by tile; half of the tiles list them the other way round."""
    cases = _cases()
    halves = _halves(cases)
    for capacities in _CAPACITIES:
        tracer, trees = TiledTracer(device, capacities), [part_tree(each, device) for each in halves]
        table = np.stack([each.row for each in trees])
        for query, _ in _shadows(cases):
            bits, expected = new_bits(query), new_bits(query)
            trace_shadow(as_built(cases.bvh), query, expected, 1)
            (h, w), spp = query.sides.shape, query.samples.shape[1]
            layout = TileLayout(_TILE, -(-w // _TILE), 0, spp)
            tiles = np.arange(layout.across * -(-h // _TILE), dtype=np.int32)
            tiled = tracer.query(query, layout, 1)
            for turn in 0, 1:  # a tile has both trees at once, or one after the other
                items = np.where(tiles % 3 == 0, [[0], [1]], np.where(tiles % 3 == 1, [[1], [0]], [[turn], [-1]])).T
                items = items if turn == 0 else np.where((tiles % 3 == 2)[:, None], items, -1)
                starts = np.concatenate([[0], np.cumsum((items >= 0).sum(1))])
                lists = TreeLists(table, starts.astype(np.int32), items[items >= 0].astype(np.int32), 1)
                words, _ = tracer.trace_tiles(tiled, tiles if turn == 0 else tiles[2::3], lists, 1)
                set_bits(bits, layout, tiles if turn == 0 else tiles[2::3], words)
            yield bits, expected


def _compared_list_hits(device: Device) -> Iterator[Comparison]:
    """The nearest hits of one ray per pixel in several trees; the rays point anywhere."""
    cases, (h, w) = _cases(), _PIXELS
    halves = _halves(cases)
    origins, ends = _lines(np.random.default_rng(_SEED), cases.vertices)
    rays, across = (origins, ends - origins, np.full(_RAYS, -1, np.int32)), -(-w // _TILE)
    vectors = RayVectors(*rays, np.array([[0.0, np.inf]]), 0)
    face, t = nearest_hits(cases.bvh, *rays, 1)
    tiles = np.arange(across * -(-h // _TILE), dtype=np.int32)
    for capacities in _CAPACITIES:
        tracer, hits = TiledTracer(device, capacities), no_hits((h, w))
        trees = [part_tree(each, device) for each in halves]
        starts, items = 2 * np.arange(len(tiles) + 1, dtype=np.int32), np.tile(np.array([0, 1], np.int32), len(tiles))
        lists = TreeLists(np.stack([each.row for each in trees]), starts, items, 1)
        tiled = TiledRays(tracer, RayGrid(_TILE, across, (h, w), slice(0, h)), vectors, hits)
        tiled.trace_nearest(tiles, lists, np.arange(2, dtype=np.int32), 1)
        yield from ((hits.face.reshape(-1), face), (hits.t.reshape(-1), t))


COMPARISONS: list[Callable[[Device], Iterator[Comparison]]] = [
    _compared_trees,
    _compared_vertices,
    _compared_surfaces,
    _compared_cutouts,
    _compared_instances,
    _compared_lists,
    _compared_list_hits,
]
"""What the self-test compares besides the answers of queries. Modules with other kernels of devices add to it."""


# --- First use --------------------------------------------------------------------------------------------------------


def open_tested(name: str | Device, max_memory: int | None = None) -> Device:
    """`open_device`, with the self-test on the first use of a card.

    Raises
    ------
    DeviceError
        If the card's answers are wrong.
    """
    device = open_device(name, max_memory)
    if device.kind != "host":  # no card and no driver: its code is checked by the project's own tests
        check_device(device)
    return device


def check_device(device: Device) -> None:
    """Run the self-test unless this card has passed it, with this driver and these kernels.

    Raises
    ------
    DeviceError
        If the answers are wrong.
    """
    path = _pass_of(device)
    if path in _passed:
        return
    if not path.exists():
        answers, wrong = run_self_test(open_device(device.name))  # not within the owner's budget
        if wrong:
            raise DeviceError(
                f"{device}: {wrong} of {answers} answers in its self-test are wrong, so it is not used; update its "
                "driver, or compute on the CPU"
            )
        with suppress(OSError):  # the cache is not writable: the test is repeated in each process
            make_folder(path.parent)
            path.touch(mode=0o600)
    _passed.add(path)


_passed: set[Path] = set()


def _pass_of(device: Device) -> Path:
    """The file that exists once a card has passed with its driver and our kernels."""
    digest = blake2b(f"{device.kind} {device.model} {device.driver}".encode(), digest_size=16)
    for kernel in KERNELS.values():
        digest.update(kernel.code(cast(Form, device.form)).digest.encode())
    return cache_root() / "devices" / f"{digest.hexdigest()}.passed"
