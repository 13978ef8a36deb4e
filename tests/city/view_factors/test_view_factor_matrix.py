"""`ViewFactors`: reciprocity and files."""

import csv
import json

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import radiation_shapes as shapes
from strength import examples


def room(seed=0, samples=256):
    boxes = [*shapes.box((3, 4, 5)), np.concatenate(shapes.box((1, 1, 1), -1.0)) + (1, 1, 1)]
    scene, parts = shapes.scene_of(*boxes)
    return at.view_factors(scene, parts, samples=samples, seed=seed)


def street(samples=1024):
    walls = shapes.rectangle((0, 0, 0), (0, 9, 0), (0, 0, 4)), shapes.rectangle((5, 0, 0), (0, 0, 4), (0, 9, 0))
    scene, parts = shapes.scene_of(shapes.rectangle((0, 0, 0), (5, 0, 0), (0, 9, 0)), *walls)
    return at.view_factors(scene, parts, samples=samples)


@examples(10)
@given(st.integers(0, 1000))
def test_reciprocal_factors_of_a_room(seed):
    found = room(seed)
    assert found.reciprocity_error > 1e-3
    both = found.reciprocal()
    exchange = both.areas[:, None] * both.factors.toarray()
    np.testing.assert_allclose(exchange, exchange.T, rtol=1e-14)
    np.testing.assert_allclose(both.matrix.sum(axis=1), 1.0, atol=2e-13)
    assert both.reciprocity_error < 1e-14 and (both.factors.toarray() >= 0.0).all()
    np.testing.assert_allclose(both.factors.toarray(), found.factors.toarray(), atol=0.15)
    assert both.about == {**found.about, "reciprocal": True} and "reciprocal" not in found.about


def test_reciprocal_factors_of_an_open_scene():
    found = street()
    both = found.reciprocal()
    exchange = both.areas[:, None] * both.factors.toarray()
    np.testing.assert_allclose(exchange, exchange.T, rtol=1e-14)
    np.testing.assert_allclose(both.matrix.sum(axis=1), 1.0, atol=2e-13)
    np.testing.assert_allclose(both.sky, found.sky, atol=0.01)
    assert (both.sky > 0.2).all() and both.sky[0] > 0.3


def test_averages_have_smaller_errors():
    found = room(samples=1 << 12)
    before, after = (each.errors[:, :7].toarray() for each in (found, found.reciprocal()))
    assert np.median(after[before > 0] / before[before > 0]) < 0.9


@pytest.mark.parametrize("make", [room, street, lambda: room().reciprocal()], ids=["room", "street", "reciprocal"])
def test_files(make, tmp_path):
    found = make()
    found.save(tmp_path / "a.npz")
    found.save(tmp_path / "a.csv")
    matrix = scipy.sparse.load_npz(tmp_path / "a.npz")
    assert (matrix != found.matrix).nnz == 0 and matrix.shape == (len(found), len(found) + 3)
    with np.load(tmp_path / "a.npz") as arrays:
        assert arrays["names"].tolist() == found.names and (arrays["areas"] == found.areas).all()
        assert json.loads(str(arrays["about"])) == found.about
        errors = scipy.sparse.csr_array((arrays["errors"], matrix.indices, matrix.indptr), matrix.shape)
    assert abs(errors - found.errors).max() == 0.0
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == found.matrix.nnz > 5
    names = [*found.names, "sky", "ground", "other"]
    for row in rows:
        i, j = names.index(row["from"]), names.index(row["to"])
        assert float(row["factor"]) == found.matrix[i, j] and float(row["error"]) == found.errors[i, j]
        assert float(row["area"]) == found.areas[i]


def test_errors(tmp_path):
    found = street()
    with pytest.raises(at.InputError, match="npz"):
        found.save(tmp_path / "a.txt")
    with pytest.raises(at.InputError, match="names of view factors must be 3 strings"):
        at.ViewFactors(["a"], [""], found.areas, found.matrix, found.errors)
    with pytest.raises(
        at.InputError, match=r"matrix of view factors must be a scipy.sparse.csr_array of shape \(3, 6\)"
    ):
        at.ViewFactors(found.names, found.types, found.areas, found.matrix.toarray(), found.errors)
    assert repr(found) == "ViewFactors(3 surfaces, 6 view factors)"
