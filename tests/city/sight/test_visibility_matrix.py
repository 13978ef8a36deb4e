"""Visibility matrices: every bit equals the oracle, in memory and streamed, after an interruption too."""

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.city.sight import visibility_matrix
from antumbra.city.sight.mutual_horizons import hidden_by_horizons
from antumbra.city.sight.visibility_matrix import TileTracer
from antumbra.city.tables import bit_matrices
from antumbra.engine.plan import covering_plans
from devices import device_plans
from sight_scenes import expected, scene_of
from strength import examples


@pytest.fixture
def small_strips(monkeypatch):
    """Strips of 64 points and lists of 64 lights, so that small matrices have many tiles."""
    monkeypatch.setattr(visibility_matrix, "STRIP", 64)
    monkeypatch.setattr(visibility_matrix, "MAX_SPP", 64)


@pytest.mark.parametrize("columns", [1, 63, 64, 65, 130])
def test_bits_are_packed_unpacked_and_transposed(columns):
    rows = np.random.default_rng(columns).random((77, columns)) < 0.5
    words = bit_matrices.pack_bits(rows)
    assert words.shape == (77, bit_matrices.words_of(columns)) and words.dtype == np.uint64
    assert np.array_equal(bit_matrices.unpack_bits(words, columns), rows)
    assert np.array_equal(bit_matrices.unpack_bits(bit_matrices.transpose_bits(words, columns), 77), rows.T)
    assert words[0, -1] < 2 ** ((columns - 1) % 64 + 1)
    order = np.random.default_rng(0).permutation(columns)
    assert np.array_equal(bit_matrices.unpack_bits(bit_matrices.reorder_bits(words, order), columns), rows[:, order])


@examples(10)
@given(st.integers(0, 2**32 - 1))
def test_free_points_equal_the_oracle(seed):
    scene, rng = scene_of(seed)
    points, targets = rng.uniform(-1.5, 1.5, (70, 3)), rng.uniform(-1.5, 1.5, (20, 3))
    made = at.visibility_matrix(scene, points, targets)
    want = expected(scene, (points, None), (targets, None))
    assert np.array_equal(made.rows(), want)
    assert np.array_equal(made.counts, want.sum(1)) and made.shape == (70, 20)


@examples(5)
@given(st.integers(0, 2**32 - 1))
def test_points_with_themselves_equal_the_oracle(seed):
    scene, rng = scene_of(seed)
    points = rng.uniform(-1.5, 1.5, (90, 3))
    made = at.visibility_matrix(scene, points).rows()
    want = expected(scene, (points, None), (points, None))
    np.fill_diagonal(want, False)
    assert np.array_equal(made, want) and 0 < want.sum() < want.size - 90


def test_faces_see_each_other_on_their_outer_sides_only(small_strips):
    scene, _ = scene_of(5, 150)
    sensors = at.face_sensors(scene)
    made = at.visibility_matrix(scene, sensors).rows()
    want = expected(scene, (sensors.points, sensors.normals), (sensors.points, sensors.normals))
    assert np.array_equal(made, want) and np.array_equal(want, want.T)
    assert 0.01 < want.mean() < 0.5 and not want.diagonal().any()


@pytest.mark.parametrize("plan", [*covering_plans(), "bsah+multifrusta", *device_plans()], ids=str)
def test_segments_that_need_no_tracing_do_not_change_the_others(small_strips, plan):
    scene, rng = scene_of(11, 60)
    points, normals = rng.uniform(-1.5, 1.5, (130, 3)), rng.normal(size=(130, 3))
    made = at.visibility_matrix(scene, points, normals=normals, plan=plan).rows()
    want = expected(scene, (points, normals), (points, normals))
    np.fill_diagonal(want, False)
    assert np.array_equal(made, want) and 0.02 < want.mean() < 0.3


@pytest.mark.parametrize("sides", ["both", "rows", "columns", "none"])
def test_pairs_are_hidden_by_either_horizon(sides):
    rng = np.random.default_rng(3)
    ends = [rng.integers(-2, 3, (n, 3)).astype(float) for n in (37, 130)]  # some lie exactly on a horizon
    normals = [np.eye(3)[rng.integers(0, 3, len(each))] if sides in ("both", name) else None
               for each, name in zip(ends, ("rows", "columns"))]  # fmt: skip
    a, b = (at.Receivers.of(each, n, np.zeros(3)) for each, n in zip(ends, normals))
    found = bit_matrices.unpack_bits(hidden_by_horizons(a, b), 130)
    away, want = b.origins[0][None].astype(float) - a.origins[0][:, None], np.zeros((37, 130), bool)
    if normals[0] is not None:
        want |= np.einsum("ijk,ik->ij", away, normals[0]) <= 0.0
    if normals[1] is not None:
        want |= np.einsum("ijk,jk->ij", -away, normals[1]) <= 0.0
    assert np.array_equal(found, want) and want.any() == (sides != "none") and not want.all()


def test_normals_of_targets_alone(small_strips):
    scene, rng = scene_of(6)
    points, targets, normals = rng.uniform(-1.5, 1.5, (70, 3)), rng.uniform(-1, 1, (66, 3)), rng.normal(size=(66, 3))
    made = at.visibility_matrix(scene, points, targets, target_normals=normals).rows()
    want = expected(scene, (points, None), (targets, normals))
    assert np.array_equal(made, want) and 0.1 < want.mean() < 0.5


def test_the_segment_not_a_rounded_direction_decides():
    """A target just behind a wall, in a scene far from it: one unit in the last place more or less matters."""
    wall = np.array([[[1, -9, -9], [1, 9, -9], [1, 0, 9]]], np.float32)
    scene = at.Scene.from_arrays(np.concatenate([wall, wall - (2, 0, 0)]))
    x = np.nextafter(np.float32(1.0), np.float32([0.0, 1.0, 2.0]))
    targets = np.stack([x, [0.123] * 3, [0.3] * 3], 1)
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 3)).astype(np.float32)
    made = at.visibility_matrix(scene, points, targets).rows()
    assert np.array_equal(made, np.broadcast_to([True, True, False], made.shape))


def test_a_streamed_matrix_has_the_same_bits(small_strips, tmp_path):
    scene, rng = scene_of(7)
    points = rng.uniform(-1.5, 1.5, (200, 3))
    kept = at.visibility_matrix(scene, points)
    streamed = at.visibility_matrix(scene, points, output=tmp_path / "m.npy")
    assert np.array_equal(kept.bits, streamed.bits) and np.array_equal(kept.counts, streamed.counts)
    assert np.array_equal(np.load(tmp_path / "m.npy"), kept.bits)
    assert [file.name for file in tmp_path.iterdir()] == ["m.npy"]


def test_an_interrupted_matrix_goes_on(small_strips, tmp_path, monkeypatch):
    scene, rng = scene_of(8)
    points, tiles, visible = rng.uniform(-1.5, 1.5, (200, 3)), [], TileTracer.visible

    def stops(self, rows, columns):
        tiles.append((rows.n, columns.n))
        if len(tiles) == 5:
            raise KeyboardInterrupt
        return visible(self, rows, columns)

    monkeypatch.setattr(TileTracer, "visible", stops)
    with pytest.raises(KeyboardInterrupt):
        at.visibility_matrix(scene, points, output=tmp_path / "m.npy")
    assert len(tiles) == 5 and not (tmp_path / "m.npy").exists()
    made = at.visibility_matrix(scene, points, output=tmp_path / "m.npy")
    assert len(tiles) == 5 + 6  # of ten tiles, four were finished
    assert np.array_equal(made.bits, at.visibility_matrix(scene, points).bits)


def test_sparse_matrices_are_scipys(tmp_path):
    scene, rng = scene_of(9)
    made = at.visibility_matrix(scene, rng.uniform(-1.5, 1.5, (300, 3)), rng.uniform(-1.5, 1.5, (70, 3)))
    made.save(tmp_path / "m.npz")
    read = scipy.sparse.load_npz(tmp_path / "m.npz")
    for found in (read, made.sparse()):
        assert isinstance(found, scipy.sparse.csr_array) and found.shape == (300, 70)
        assert np.array_equal(found.toarray(), made.rows()) and found.dtype == bool
    made.save(tmp_path / "m.npy")
    assert np.array_equal(np.load(tmp_path / "m.npy"), made.bits)


@pytest.mark.parametrize(
    "arguments, words",
    [
        ({"sensors": np.zeros((4, 2))}, "sensors must have shape"),
        ({"sensors": np.zeros((4, 3)), "targets": [[np.nan, 0, 0]]}, "targets hold NaN"),
        ({"sensors": np.zeros((4, 3)), "target_normals": [0, 0, 1]}, "target_normals need targets"),
        ({"sensors": np.zeros((4, 3)), "output": "m.txt"}, "use .npy"),
        ({"sensors": np.zeros((200_000, 3))}, "give an output"),
    ],
)
def test_bad_input(arguments, words):
    with pytest.raises(at.InputError, match=words):
        at.visibility_matrix(scene_of(1)[0], **arguments)


def test_no_points():
    assert at.visibility_matrix(scene_of(1)[0], np.empty((0, 3)), np.zeros((4, 3))).shape == (0, 4)
    assert at.visibility_matrix(scene_of(1)[0], np.zeros((4, 3)), np.empty((0, 3))).rows().shape == (4, 0)
