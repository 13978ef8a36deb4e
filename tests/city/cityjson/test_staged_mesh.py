"""A mesh in a scratch file gives back its parts, and removes the file with it."""

import numpy as np

from antumbra.city.cityjson.staged_mesh import StagedMesh
from antumbra.scene.mesh import ObjectInfo, make_mesh

RNG = np.random.default_rng(3)


def test_parts_are_read_as_they_were_written(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    staged, parts = StagedMesh("a.jsonl"), []
    every = []
    for n in (4, 9):
        colours = RNG.random((n, 3)).astype(np.float32)
        parts.append(make_mesh("a", RNG.normal(size=(8, 3)), RNG.integers(0, 8, (n, 3)), colours, "a"))
        owners, things = RNG.integers(0, 2, n).astype(np.int32), [ObjectInfo(f"{name}{n}", 0, 0) for name in "ab"]
        staged.add(parts[-1], owners, things)
        every.append(owners + 2 * (len(parts) - 1))
    staged.end()
    assert [each.name for each in staged.objects] == ["a4", "b4", "a9", "b9"]
    assert staged.meshes[0].triangles == 13 and not staged.in_memory and not staged.cameras(0.0) + staged.lights(0.0)
    for _ in range(2):
        for piece, part, owners in zip(staged.pieces(0.0), parts, every, strict=True):
            assert piece.owners.tolist() == owners.tolist()
            assert np.array_equal(piece.vertices[0], part.positions) and np.array_equal(piece.faces, part.faces)
            assert np.array_equal(piece.colour, part.colour) and piece.where == 'a.jsonl: mesh "a.jsonl"'
    file = staged.folder / "pieces"
    assert file.exists()
    del staged
    assert not file.exists()
