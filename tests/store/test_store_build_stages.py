"""A build resumes in any of its stages, and only what was not done is done again."""

import shutil

import numpy as np
import pytest

import antumbra as at
from antumbra.cli import build_command
from antumbra.cli.console import ProgressDisplay
from antumbra.engine import store_building
from antumbra.formats import face_ranges
from antumbra.generate import city, generated_scene
from antumbra.store import store_build
from antumbra.store.build_stages import LocalStages
from antumbra.store.read_units import ReadUnit
from antumbra.store.store_build import PieceSizes, write_store
from antumbra.work import staged_parts
from antumbra.work.executors import UnitCollector
from formats.test_face_ranges import FACES, VERTICES, ply
from gltf_files import Gltf
from stores import with_small_chunks

STAGES = "read", "sort", "build"


@pytest.fixture
def small_units(monkeypatch):
    """Units so small that a scene of 900 triangles has several in each stage."""
    monkeypatch.setattr(face_ranges, "FACES_PER_PIECE", 50)
    monkeypatch.setattr(face_ranges, "PIECES_PER_SPAN", 4)
    monkeypatch.setattr(store_build, "USUAL_SIZES", PieceSizes(staged=30, run=40, unit=150))
    monkeypatch.setattr(store_building, "write_store", with_small_chunks)


@pytest.fixture
def done(monkeypatch):
    """The units that were finished, by stage; `limit` makes a run end in a unit."""
    finished, run = {stage: [] for stage in STAGES}, staged_parts._StageParts._run

    def record(parts, first, last):
        stage = parts.about["what"].partition(" ")[0]
        if done.limit == (stage, first):
            raise KeyboardInterrupt
        arrays = run(parts, first, last)
        finished.setdefault(stage, []).append(first)
        return arrays

    monkeypatch.setattr(staged_parts._StageParts, "_run", record)
    done = type("Done", (), {"finished": finished, "limit": None})
    return done


def build(cli, *more, scene="a.ply"):
    return cli("build", scene, "-o", "a.antumbra", "--quiet", *more)


@pytest.mark.parametrize("stage", STAGES)
def test_a_build_resumes_in_any_stage(cli, tmp_path, small_units, done, stage):
    (tmp_path / "a.ply").write_bytes(ply(of="face"))
    assert build(cli).code == 0
    whole, all_units = (tmp_path / "a.antumbra").read_bytes(), {k: list(v) for k, v in done.finished.items()}
    assert all(len(units) > 3 for units in all_units.values()), all_units
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.antumbra", "a.ply"]
    (tmp_path / "a.antumbra").unlink()
    for units in done.finished.values():
        units.clear()
    done.limit = stage, 2
    assert build(cli).code == 130
    assert not (tmp_path / "a.antumbra").exists() and (tmp_path / "a.parts").is_dir()
    done.limit = None
    assert build(cli).code == 0
    assert (tmp_path / "a.antumbra").read_bytes() == whole and done.finished == all_units
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.antumbra", "a.ply"]


def test_a_changed_scene_is_built_anew(cli, tmp_path, small_units, done):
    (tmp_path / "a.ply").write_bytes(ply())
    done.limit = "build", 1
    assert build(cli).code == 130
    done.limit = None
    (tmp_path / "a.ply").write_bytes(ply(offset=1.0))
    n_before = len(done.finished["read"])
    assert build(cli).code == 0 and len(done.finished["read"]) == 2 * n_before
    at.build_store(tmp_path / "a.ply", tmp_path / "b.antumbra")
    assert (tmp_path / "a.antumbra").read_bytes() == (tmp_path / "b.antumbra").read_bytes()


def test_a_damaged_part_is_made_again(cli, tmp_path, small_units, done):
    (tmp_path / "a.ply").write_bytes(ply())
    done.limit = "build", 3
    assert build(cli).code == 130
    done.limit, made = None, len(done.finished["build"])
    damaged = next(path for path in sorted((tmp_path / "a.parts").rglob("*.bin"), reverse=True) if path.stat().st_size)
    of_build = [path for path in (tmp_path / "a.parts").rglob("000000.bin") if path.stat().st_size % 4096 == 0]
    of_build[0].write_bytes(of_build[0].read_bytes()[:-1])
    assert damaged.exists() and build(cli).code == 0
    assert done.finished["build"].count(0) == 2 and made == 3
    at.build_store(tmp_path / "a.ply", tmp_path / "b.antumbra")
    assert (tmp_path / "a.antumbra").read_bytes() == (tmp_path / "b.antumbra").read_bytes()


def test_parts_of_another_version_are_refused_in_one_line(cli, tmp_path, small_units, done):
    (tmp_path / "a.ply").write_bytes(ply())
    done.limit = "sort", 1
    assert build(cli).code == 130
    done.limit = None
    for path in (tmp_path / "a.parts").rglob("*.npz"):
        with np.load(path) as archive:
            older = {name: array for name, array in archive.items() if name != "copies"}
        np.savez(path, **older)
    build(cli).refused("a.parts", "another version of antumbra", "delete it, and build again")
    shutil.rmtree(tmp_path / "a.parts")
    assert build(cli).code == 0


def test_scenes_of_unknown_files_neither_resume_nor_are_split(cli, tmp_path):
    (tmp_path / "moving").mkdir()
    np.save(tmp_path / "moving" / "frames.npy", VERTICES[None].astype(np.float32))
    np.save(tmp_path / "moving" / "faces.npy", FACES.astype(np.int32))
    assert cli("build", "moving", "-o", "a.antumbra", "-q").code == 0 and not (tmp_path / "a.parts").exists()
    (tmp_path / "a.vrt").write_text("<VRTDataset/>")
    for option, value in (("--shard", "0/2"), ("--ray", "local")):
        for name, why in (("moving", "is a folder"), ("a.vrt", "has files that are not known")):
            told = cli("build", "procedural:cellar?triangles=2k", name, "-o", "a.antumbra", option, value)
            told.refused(f"{option} {value}", f"{name} {why}", "single file")


def put_scene(folder, name: str, colour: str) -> None:
    """A scene with its colour in another file."""
    if name == "a.obj":
        lines = [f"v {x} {y} {z}" for x, y, z in VERTICES] + [f"f {a} {b} {c}" for a, b, c in FACES + 1]
        (folder / name).write_text("\n".join(["mtllib its.mtl", "usemtl red", *lines]))
        (folder / "its.mtl").write_text(f"newmtl red\nKd {colour} 0 0\n")
        return
    made = Gltf()
    colours = made.accessor(np.full((len(VERTICES), 3), float(colour), np.float32))
    primitive = made.primitive(VERTICES.astype(np.float32), FACES.astype("<u2"), attributes={"COLOR_0": colours})
    made.node(mesh=made.mesh(primitive))
    (folder / name).write_bytes(made.gltf("its.bin"))
    (folder / "its.bin").write_bytes(made.data)


@pytest.mark.parametrize("name", ["a.obj", "a.gltf"])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_scenes_with_other_files_resume_unless_these_have_changed(cli, tmp_path, small_units, done, name):
    put_scene(tmp_path, name, "0.25")
    done.limit = "build", 1
    assert build(cli, scene=name).code == 130
    done.limit = None
    assert build(cli, scene=name).code == 0 and len(done.finished["read"]) == 1
    first = (tmp_path / "a.antumbra").read_bytes()
    done.limit = "build", 1
    assert build(cli, scene=name).code == 130
    done.limit, n_read = None, len(done.finished["read"])
    put_scene(tmp_path, name, "0.75")
    assert build(cli, scene=name).code == 0 and len(done.finished["read"]) == n_read + 1
    at.build_store(tmp_path / name, tmp_path / "b.antumbra")
    assert first != (tmp_path / "a.antumbra").read_bytes() == (tmp_path / "b.antumbra").read_bytes()


@pytest.mark.parametrize("name", ["a.obj", "a.gltf"])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_shards_of_scenes_with_other_files(cli, tmp_path, small_units, name):
    put_scene(tmp_path, name, "0.5")
    for k in range(2):
        assert cli("build", name, "-o", "a.antumbra", "--shard", f"{k}/2", "-q").code == 0
    assert cli("merge", "a.shards", "-q").code == 0
    at.build_store(tmp_path / name, tmp_path / "b.antumbra")
    assert (tmp_path / "a.antumbra").read_bytes() == (tmp_path / "b.antumbra").read_bytes()


def test_spans_of_a_city_are_its_blocks_in_any_order(monkeypatch):
    monkeypatch.setattr(city, "GROUP", 3)
    streamed = generated_scene.StreamedCity(40_000)
    assert streamed.n_spans > 1
    alone = [list(streamed.span(k)) for k in reversed(range(streamed.n_spans))]
    whole = [piece for group in city.city_groups(40_000, 0) for piece in group]
    pieces = [piece for span in reversed(alone) for piece in span]
    for piece, block in zip(pieces, whole, strict=True):
        assert np.array_equal(piece.vertices[0], block.vertices) and np.array_equal(piece.faces, block.faces)


def test_spans_that_are_read_in_order_are_generated_by_other_processes(monkeypatch):
    started = []
    monkeypatch.setattr(city, "start_worker", lambda *a, start=city.start_worker: started.append(a) or start(*a))
    streamed = generated_scene.StreamedCity(1_700_000, 3, processes=2)
    assert streamed.n_spans == 2
    pieces = [piece for k in range(2) for piece in streamed.span(k)]
    assert [words[2:] for words in started] == [(0, 2), (1, 2)] and len(pieces) == 81
    again = [*generated_scene.StreamedCity(1_700_000, 3).span(1)]
    assert len(started) == 2 and np.array_equal(again[0].vertices, pieces[64].vertices)
    streamed.close()


def test_units_of_several_scenes_are_one_store(tmp_path):
    scenes = [at.procedural("cellar", triangles=2000), at.procedural("atrium", triangles=2000)]
    at.build_store(scenes, tmp_path / "a.antumbra", chunk=64)
    units = [ReadUnit(lambda scene=scene: [scene.data]) for scene in scenes]
    (tmp_path / "parts").mkdir()
    sizes = PieceSizes(staged=100, run=150, unit=400)
    write_store(units, tmp_path / "b.antumbra", chunk=64, sizes=sizes, stages=LocalStages(tmp_path / "parts"))
    assert (tmp_path / "a.antumbra").read_bytes() == (tmp_path / "b.antumbra").read_bytes()
    assert len(list((tmp_path / "parts").glob("build-*.npz"))) > 3


def test_a_build_is_shown_as_it_goes(cli, tmp_path, small_units, monkeypatch):
    (tmp_path / "a.ply").write_bytes(ply())
    said = []
    monkeypatch.setattr(ProgressDisplay, "say", lambda self, text, done=0, total=0: said.append((text, done, total)))
    assert build(cli).code == 0
    n = int(at.load("a.antumbra").store.chunks.triangles.sum())  # without those that have no area
    assert {text for text, _, _ in said} == {"reading", "sorting", "building"}
    assert said[-1] == ("building", n, 901) and {("reading", 901, 0), ("sorting", n, 901)} <= set(said)


def test_a_node_with_another_file_beside_the_scene_is_refused(cli, tmp_path, monkeypatch):
    put_scene(tmp_path, "a.obj", "0.25")
    starts = []
    monkeypatch.setattr(build_command, "executor_for", lambda args, output, start, *more: starts.append(start))
    assert build(cli, scene="a.obj").code == 0
    (start,) = starts
    start.args[2].make()  # the folder that nodes share
    collector = UnitCollector(tmp_path / "parts")
    start({}, 1, collector)
    assert collector.work
    (tmp_path / "its.mtl").write_text("newmtl red\nKd 0.75 0 0\n")
    with pytest.raises(at.InputError, match=r"a\.obj: refers to files that node .* has otherwise; share their folder"):
        start({}, 1, collector)
