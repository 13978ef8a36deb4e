"""The looks of faces are those of the scene's appearance, whether it is in memory or read piece by piece."""

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.face_looks import LOOK_WIDTHS, FaceLooks, FoundLooks, StreamedLooks, looks_of, plain_looks
from looks_scenes import FILES


@pytest.fixture(params=FILES)
def data(request, tmp_path):
    FILES[request.param](tmp_path, request.param)
    return at.load(tmp_path / request.param).data


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_looks_of_pieces_are_those_of_the_scene(data):
    whole, first = looks_of(data.appearance), 0
    found, streamed = FoundLooks(data.appearance), StreamedLooks()
    for piece in data.source.pieces(0.0):
        (a, materials), (b, others) = found.of(piece), streamed.of(piece)
        assert [materials[k] for k in a.kind >> 1 if k >= 0] == [others[k] for k in b.kind >> 1 if k >= 0]
        assert (a.kind & 1 == b.kind & 1).all()
        expected = whole.part(first, first + len(a.kind))
        for name, (width, default) in LOOK_WIDTHS.items():
            rows = getattr(expected, name)
            if rows is not None:
                absent = np.full((len(a.kind), width), default, np.float32)
                column = getattr(b, name)
                assert np.array_equal(getattr(a, name), rows)
                assert np.array_equal(absent if column is None else column, rows), name
        first += len(a.kind)
    assert first == data.n_triangles


def test_numbers_of_materials_change_and_plain_faces_stay_plain():
    looks = FaceLooks(np.array([0, 3, -1, 2], np.int32)).numbered(np.array([7, 5], np.int32))
    assert looks.kind.tolist() == [14, 11, -1, 10]
    assert plain_looks(3).numbered(np.empty(0, np.int32)).kind.tolist() == [-1, -1, -1]
