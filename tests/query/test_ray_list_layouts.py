"""Rays in arrays of any layout and number type, one or many a call, have the same hits."""

import numpy as np
import pytest

import antumbra as at
import wasm_kernels
from python_calls import python_calls

SCENE = at.procedural("atrium", triangles=2000)
RANDOM = np.random.default_rng(2)
LOW, HIGH = SCENE.bounds
N = 1100  # more than one thread's first share of batches
ORIGINS = RANDOM.uniform(LOW, HIGH, (N, 3)).astype(np.float32).astype(np.float64)
DIRECTIONS = RANDOM.normal(size=(N, 3)).astype(np.float32).astype(np.float64)

QUERIES = {
    "occluded": lambda *rays, **ends: [SCENE.occluded(*rays, **ends)],
    "closest_hit": lambda *rays, **ends: list(SCENE.closest_hit(*rays, **ends)),
    "all_hits": lambda *rays, **ends: list(SCENE.all_hits(*rays, **ends)),
    "count_hits": lambda *rays, **ends: [SCENE.count_hits(*rays, **ends)],
}


def _columns(array):
    return np.ascontiguousarray(array.T).T


def _padded(array):
    wide = np.zeros((len(array), 7), array.dtype)
    wide[:, 2:5] = array
    return wide[:, 2:5]


LAYOUTS = {
    "float32": lambda array: array.astype(np.float32),
    "columns": _columns,
    "padded rows": _padded,
    "reversed": lambda array: array[::-1].copy()[::-1],
    "big-endian": lambda array: array.astype(">f8"),
    "a type with metadata": lambda array: array.astype(np.dtype("f8", metadata={"unit": "m"})),
    "long double": lambda array: array.astype(np.longdouble),
    "lists": lambda array: array.tolist(),
}


def same(ours, wanted):
    return all(np.array_equal(a, b) for a, b in zip(ours, wanted, strict=True))


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("query", QUERIES)
def test_layouts_and_number_types_change_nothing(query, layout):
    call, change = QUERIES[query], LAYOUTS[layout]
    wanted = call(ORIGINS, DIRECTIONS)
    assert len(np.unique(wanted[0])) > 1
    assert same(call(change(ORIGINS), change(DIRECTIONS)), wanted)
    assert same(call(change(ORIGINS), DIRECTIONS), wanted)


@pytest.mark.parametrize("shape", [(N,), (N // 11, 11), (1, N, 1)])
@pytest.mark.parametrize("query", QUERIES)
def test_shapes_change_nothing_but_the_shape(query, shape):
    call = QUERIES[query]
    wanted, ours = call(ORIGINS, DIRECTIONS), call(*(each.reshape(*shape, 3) for each in (ORIGINS, DIRECTIONS)))
    if query != "all_hits":
        assert all(each.shape == shape for each in ours)
    assert same([each.reshape(-1) for each in ours], wanted)


INTEGERS = np.rint(ORIGINS).astype(np.int64), np.rint(100 * DIRECTIONS).astype(np.int16)


@pytest.mark.parametrize("query", QUERIES)
def test_integers_are_numbers_too(query):
    call = QUERIES[query]
    wanted = call(*(each.astype(np.float64) for each in INTEGERS))
    assert len(np.unique(wanted[0])) > 1 and same(call(*INTEGERS), wanted)


ENDS = {
    "numbers": (0.25, 2.0),
    "NumPy's numbers": (np.float32(0.25), np.float64(2.0)),
    "integers": (np.float16(0.25), 2),
    "arrays without axes": (np.array(0.25), np.array(2)),
    "one for each": (np.full(N, 0.25), np.full(N, 2.0, np.float32)),
    "broadcast": (np.broadcast_to(0.25, N), np.broadcast_to(np.float32(2.0), (N,))),
    "mixed": (0.25, np.full(N, 2)),
}


@pytest.mark.parametrize("form", ENDS)
@pytest.mark.parametrize("query", QUERIES)
def test_ends_in_any_form_mean_the_same(query, form):
    tmin, tmax = ENDS[form]
    call = QUERIES[query]
    wanted = call(ORIGINS, DIRECTIONS, tmin=0.25, tmax=2.0)
    assert not same(wanted, call(ORIGINS, DIRECTIONS)) if query == "count_hits" else True
    assert same(call(ORIGINS, DIRECTIONS, tmin=tmin, tmax=tmax), wanted)


@pytest.mark.parametrize("form", [int, np.int64, np.array, lambda face: np.full(N, face, np.int16)])
@pytest.mark.parametrize("query", QUERIES)
def test_skipped_faces_in_any_form_mean_the_same(query, form):
    face = int(np.bincount(SCENE.all_hits(ORIGINS, DIRECTIONS).face).argmax())
    call = QUERIES[query]
    wanted = call(ORIGINS, DIRECTIONS, skip_face=np.full(N, face))
    assert same(call(ORIGINS, DIRECTIONS, skip_face=form(face)), wanted)
    assert not same(wanted, call(ORIGINS, DIRECTIONS)) or query == "occluded"


@pytest.mark.parametrize("n", [0, 1, 2, 63, 64, 65, 1024, 1025])
def test_the_hits_of_a_few_rays_are_those_of_many(n):
    some = ORIGINS[:n], DIRECTIONS[:n]
    every, part = SCENE.all_hits(ORIGINS, DIRECTIONS), SCENE.all_hits(*some)
    assert np.array_equal(part.ray_offsets, every.ray_offsets[: n + 1])
    assert same(part[1:], [each[: part.ray_offsets[-1]] for each in every[1:]])
    for query in ("occluded", "closest_hit", "count_hits"):
        call = QUERIES[query]
        assert same(call(*some), [each[:n] for each in call(ORIGINS, DIRECTIONS)])
    assert np.array_equal(SCENE.contains(some[0]), SCENE.contains(ORIGINS)[:n])


MOST_CALLS = {"occluded": 44, "closest_hit": 50, "all_hits": 78, "count_hits": 50}


@pytest.mark.skipif(wasm_kernels.wanted(), reason="WebAssembly is called through Python")
@pytest.mark.parametrize("query", QUERIES)
def test_one_ray_takes_few_calls_within_python(query):
    rays = ORIGINS[:1], DIRECTIONS[:1]
    assert 20 < python_calls(lambda: getattr(SCENE, query)(*rays)) <= MOST_CALLS[query]
