"""Shards of every command, and their merge: the bytes of the whole, and errors that name what is wrong."""

import inspect
import json
import re
import shutil
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.base.command_registry import COMMANDS
from antumbra.cli.shards import parse_shard
from antumbra.cli.study_run import StudyCommand
from antumbra.picture.image_files import note_of
from antumbra.store.system_resources import peak_resident_memory
from antumbra.work import executors, work_parts
from antumbra.work.executors import JOB, read_shard_record, write_shard_record
from antumbra.work.work_parts import Parts
from formats.test_face_ranges import ply
from gis_files import hills, write_raster
from range_server import serving
from stores import with_small_chunks

CITY = "procedural:city?triangles=3000"
SUN = (
    "sun",
    CITY,
    "--latitude",
    52,
    "--longitude",
    4.36,
    "--days",
    "2026-03-21",
    "--step",
    120,
    "--sensors",
    "raster:8",
)
PICTURE = ("render", CITY, "--size", "70x75", "--spp", 4)
AT_NOON = ("--latitude", 52, "--longitude", 4.36, "--at", "2026-03-21T12:00")
EYES = ("--sensors", "raster:8+1.6", "--observer", "10,30,5", "--observer", "-40,20,12")
JOBS = {
    "sun on surfaces": (*SUN[:-1], "grid:12+0.01", "--surfaces", "WallSurface", "-o", "a.csv", "-o", "a.parquet"),
    "partitions of sun": (*SUN, "--by", "month", "-o", "a.parquets", "-o", "a.parquet"),
    "partitions of a viewshed": ("viewshed", CITY, *EYES, "--each", "-o", "a.parquets", "-o", "a.csv"),
    "partitions of visible": (
        *("visible", CITY, *EYES[:2], "--turbine", "0,0,0", "--hub-height", 60, "--rotor", 40, "-o", "a.parquets"),
    ),
    "sun of a raster": (*SUN, "-o", "a.tif", "-o", "a.parquet"),
    "viewshed": ("viewshed", CITY, *EYES, "--each", "-o", "a.tif", "-o", "a.csv"),
    "viewshed with bits": ("viewshed", CITY, *EYES, "--bits", "b.npy", "-o", "a.png"),
    "visible": ("visible", CITY, *EYES[:2], "--turbine", "0,0,0", "--hub-height", 60, "--rotor", 40, "-o", "a.tif"),
    "lines": ("los", CITY, "--from", "10,30,5", "--from", "0,2,0", "--targets", "targets.csv", "-o", "a.csv"),
    "skylines": ("skyline", CITY, "--points", "raster:30+1.6", "--azimuth-step", 30, "-o", "a.csv"),
    "view factors": ("view-factors", CITY, "--samples", 64, "-o", "a.csv"),
    "shadow on cells": ("shadow", CITY, *AT_NOON, "--cell", 4, "-o", "a.geojson", "-o", "a.tif"),
    "hours of shadow": ("shadow", CITY, *AT_NOON[:4], "--days", "2026-03-21", "--cell", 6, "-o", "a.geojson"),
    "shadow on a plane": ("shadow", CITY, *AT_NOON, "-o", "a.geojson"),
    "sun": (*SUN, "-o", "a.csv", "-o", "a.png"),
    "sky and matrix": (*SUN, "--sky-view", 32, "-o", "a.npz", "--matrix", "m.npy"),
    "vertices": ("bake", "procedural:atrium?triangles=1000", "-o", "a.glb", "--spp", 8),
    "light": ("bake", "procedural:atrium?triangles=1000", "-o", "a.glb", "--what", "light", "--spp", 4),
    "visibility": ("matrix", CITY, "--sensors", "raster:10", "-o", "a.npy", "--sparse", "b.npz", "--counts", "c.csv"),
    "png": (*PICTURE, "-o", "a.png"),
    "adaptive": (*PICTURE, "--adaptive", "--adaptive-spp", 16, "-o", "a.exr"),
    "bounce": (*PICTURE, "--bounce", 2, "--no-filter", "-o", "a.exr"),
    "frames": ("render", CITY, "--size", "24", "--frames", "3:9:2", "-o", "f.##.png", "--spp", 4),
    "store": ("build", CITY, "mesh.ply", "-o", "a.antumbra"),
    "data set": ("dataset", CITY, "-o", "set", "--random", 3, "--random-lights", 1, "--size", "24x24", "--spp", 2),
}


UNSAMPLED = {"shadow on a plane", "visibility", "png", "adaptive", "bounce", "frames", "store", "data set"}
"""Those whose parts have few items: the second part is their sample."""

MESH = ply(of="face")
TARGETS = "x,y,z\n" + "".join(f"{3 * k - 40},{1 + k % 7},{20 - k}\n" for k in range(30))


@pytest.fixture
def small_parts(monkeypatch):
    """Parts so small that the jobs of these tests have several."""
    from antumbra.baking import surface_meter
    from antumbra.city.shadow import shadow
    from antumbra.city.sight import sightlines, targets, viewshed, visibility_matrix
    from antumbra.city.skyline import skyline
    from antumbra.city.sun import sun_visibility
    from antumbra.city.view_factors import view_factors
    from antumbra.engine import store_building
    from antumbra.formats import face_ranges
    from antumbra.store import store_build

    for module in sun_visibility, targets, viewshed:
        monkeypatch.setattr(module, "SENSORS_PER_PART", 100)
    monkeypatch.setattr(sightlines, "PAIRS_PER_PART", 8)
    monkeypatch.setattr(skyline, "POINTS_PER_PART", 5)
    monkeypatch.setattr(view_factors, "RAYS_PER_PART", 64 * 200)
    monkeypatch.setattr(shadow, "GROUPS_PER_PART", 1)
    monkeypatch.setattr(surface_meter, "BLOCKS_PER_PART", 60)
    monkeypatch.setattr(work_parts, "BAND", 16)
    monkeypatch.setattr(visibility_matrix, "STRIP", 128)
    monkeypatch.setattr(store_building, "write_store", with_small_chunks)
    monkeypatch.setattr(face_ranges, "PIECES_PER_SPAN", 1)
    monkeypatch.setattr(face_ranges, "FACES_PER_PIECE", 300)
    monkeypatch.setattr(store_build, "USUAL_SIZES", store_build.PieceSizes(staged=300, run=300, unit=300))


def contents(folder) -> dict[str, bytes]:
    files = (path for path in Path(folder).rglob("*") if path.is_file())
    inputs = "targets.csv", "mesh.ply"
    return {str(path.relative_to(folder)): path.read_bytes() for path in files if path.name not in inputs}


@pytest.fixture
def run(cli, tmp_path, monkeypatch):
    """Runs a command in a folder of its own: run("name", "sun", ...)."""

    def run(folder, *words, code=0):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "targets.csv").write_text(TARGETS)
        (tmp_path / folder / "mesh.ply").write_bytes(MESH)
        monkeypatch.chdir(tmp_path / folder)
        done = cli(*words)
        assert done.code == code, done
        return done

    return run


def shards_of(folder) -> Path:
    (found,) = Path(folder).glob("*.shards")
    return found


@pytest.mark.parametrize("job", JOBS)
def test_merged_shards_are_the_bytes_of_the_whole(run, tmp_path, small_parts, job):
    words = JOBS[job]
    run("whole", *words, "--quiet")
    whole = contents(tmp_path / "whole")
    assert whole and not any(".parts" in name for name in whole)
    for n in (2, 7):
        folder, parts = tmp_path / f"of {n}", []
        for i in reversed(range(n)):
            run(folder.name, *words, "--shard", f"{i}/{n}", "--quiet")
            parts.append(sum(path.suffix in (".npz", ".parquet") for path in folder.rglob("0*")))
        if job not in ("frames", "data set"):  # their results are their parts
            assert not set(contents(folder)) & set(whole)
            assert parts[-1] >= (1 if job == "shadow on a plane" else 3)  # one object; 7 shards may have nothing to do
        done = run(folder.name, "merge", shards_of(folder))
        assert "rays/s" not in done.out  # which were traced before
        shutil.rmtree(shards_of(folder))
        assert contents(folder) == whole, (job, n)


@pytest.mark.parametrize("job", ["sun", "partitions of sun", "png", "frames", "store", "data set"])
def test_shards_of_several_machines_are_merged(run, tmp_path, small_parts, job):
    words = JOBS[job]
    run("whole", *words, "--quiet")
    for i in range(3):
        run(f"node{i}", *words, "--shard", f"{i}/3", "--quiet")
    folders = [shards_of(tmp_path / f"node{i}") for i in range(3)]
    told = run("merged", "merge", *folders[:2], "-q", code=75)
    assert "shard 2/3 is not complete" in told.err and "--shard 2/3" in told.err
    assert "a.shards: no shard has begun" in run("none", "merge", "a.shards", code=75).err
    told = run("merged", "merge", *folders, folders[1].parent / "." / folders[1].name, "--quiet")
    assert contents(tmp_path / "merged") == contents(tmp_path / "whole")
    twice = tmp_path / "twice" / folders[0].name
    shutil.copytree(folders[0].parent, twice.parent)
    run("again", "merge", *folders, twice, "-q")
    assert contents(tmp_path / "again") == contents(tmp_path / "whole")
    other = next(path for path in sorted(twice.parent.rglob("*")) if path.stem in ("000000", "f.03", "0000"))
    damaged = np.load(other) if other.suffix == ".npz" else None
    if damaged is not None:  # complete, and with another result
        arrays = {name: values if values.dtype.kind == "U" else values + 1 for name, values in damaged.items()}
        np.savez(other, **arrays)
        run("other", "merge", *folders, twice, "-q", code=2).refused("is there twice, and differs", str(twice))


@pytest.mark.parametrize("job", JOBS)
def test_every_job_tells_before_its_work_what_its_parts_take(run, tmp_path, small_parts, monkeypatch, job):
    """Where a sample would not be small beside the work, it tells after the second part."""
    for name, value in {"_LEAST": 2, "_MANY": 3, "_PIECE": 2, "_PLACES": 2}.items():
        monkeypatch.setattr(work_parts, name, value)
    told, done, do_missing = [], [], executors.do_missing
    monkeypatch.setattr(executors, "tell_estimate", lambda what, folder, unit, left: told.append((what, unit, left)))

    def measured(share):
        did = do_missing(share)
        for units, numbers in share:
            sizes = [sum((units.root / file).stat().st_size for file in units.files(k)) for k in numbers]
            done.append((units.what, sizes, isinstance(units, Parts)))
        return did

    monkeypatch.setattr(executors, "do_missing", measured)
    run("a", *JOBS[job], "-q")
    expected = {what for what, sizes, _ in done if len(sizes) > 1}
    assert expected <= {what for what, *_ in told} or job in ("frames", "data set", "store"), (done, told)
    peak = peak_resident_memory()
    for what, sizes, _ in done:
        for _, unit, left in [each for each in told if each[0] == what and each[1].source != "one part"]:
            assert left == len(sizes) and 0.5 < unit.size * left / sum(sizes) < 2.0, (what, unit, sizes)
            assert peak / 2.0 < unit.memory < 2.0 * peak
    sampled = {unit.source for _, unit, _ in told} - {"one part"}
    assert bool(sampled) == (job not in UNSAMPLED), (job, sampled)


def test_a_shard_goes_on_and_says_what_it_did(run, tmp_path, small_parts):
    words = (*JOBS["sun"], "--shard", "1/2")
    first = run("a", *words, "--json").json()
    assert first["shard"] == "1/2" and first["done"] == first["parts"] > 1
    file = next((tmp_path / "a").rglob("0*.npz"))
    before = file.read_bytes()
    file.write_bytes(before[:100])
    again = run("a", *words, "--json").json()
    assert again["done"] == 1 and again["parts"] == first["parts"] and file.read_bytes() == before
    told = run("a", *words)
    assert "1/2" in told.out and "were already done" in told.out and "antumbra merge a.shards" in told.out


@pytest.mark.parametrize("more", [(), ("--shard", "1/2")])
def test_an_interrupted_run_says_how_many_parts_are_kept(run, tmp_path, small_parts, monkeypatch, more):
    do = Parts.do

    def interrupted(parts, k):
        if k >= 2:
            raise KeyboardInterrupt
        do(parts, k)

    monkeypatch.setattr(Parts, "do", interrupted)
    told = run("a", *JOBS["sun"], *more, code=130)
    n = len(list(tmp_path.rglob("0*.npz")))
    assert n == (1 if more else 2) and f"note: {n} of " in told.err and "run it again to resume from there" in told.err
    monkeypatch.setattr(Parts, "do", do)
    run("a", *JOBS["sun"], *more, "-q")


def test_shards_may_have_their_options_in_any_order_and_spelling(run, tmp_path, small_parts):
    run("whole", *JOBS["sun"], "--quiet")
    run("a", *JOBS["sun"], "--shard", "0/2", "--quiet")
    scene, options = CITY, dict(zip(SUN[2::2], SUN[3::2]))
    words = ["-o", "./a.csv", *(f"{name}={value}" for name, value in reversed(options.items())), "--output", "a.png"]
    run("a", "sun", *words, "--by=month", scene, "--shard", "1/2", code=2).refused("another command")
    run("a", "sun", "--threads", 1, *words, scene, "--shard", "1/2", "--json")
    run("a", "merge", "a.shards", "--quiet")
    shutil.rmtree(tmp_path / "a" / "a.shards")
    assert contents(tmp_path / "a") == contents(tmp_path / "whole")


def test_foreign_and_stale_shards_are_refused_by_name(run, tmp_path, small_parts):
    (tmp_path / "a").mkdir()
    model = tmp_path / "a" / "model.obj"
    model.write_text("v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nv 0 1 0\nf 3 2 1\nf 4 3 1\nf 1 2 5\n")
    words = ("sun", "model.obj", *SUN[2:-1], "raster:0.1", "-o", "a.csv")
    run("a", *words, "--shard", "0/1", "-q")
    run("a", *words, "--energy", "--shard", "0/1", code=2).refused("a.shards", "another command")
    model.write_text(model.read_text().replace("v 0 1 0", "v 0 2 0"))
    told = run("a", "merge", "a.shards", code=2)
    told.refused("a.shards/", "stale", "scene as it was before")
    run("a", *words, "--shard", "0/1", "-q")
    run("a", "merge", "a.shards", code=2).refused("stale", "remove it")
    stale = told.err.split()[1].rstrip(":")
    shutil.rmtree(tmp_path / "a" / stale)
    run("a", "merge", "a.shards", "-q")
    assert (tmp_path / "a" / "a.csv").exists()
    part = next((tmp_path / "a" / "a.shards").rglob("000001.npz"))
    part.write_bytes((part.parent / "000000.npz").read_bytes())
    run("a", "merge", "a.shards", code=2).refused("shard 0/1", "000001.npz is damaged, or of another job")


def test_shards_of_another_format_are_refused_by_name(tmp_path):
    write_shard_record(tmp_path, ["render", "a.glb"], 2)
    assert read_shard_record(tmp_path) == (["render", "a.glb"], 2)
    record = json.loads((tmp_path / JOB).read_text())
    (tmp_path / JOB).write_text(json.dumps(record | {"format": 2}))
    for use in (lambda: read_shard_record(tmp_path), lambda: write_shard_record(tmp_path, ["render", "a.glb"], 2)):
        with pytest.raises(at.InputError, match="format 2, and this antumbra reads format 1; use the version"):
            use()


@pytest.mark.parametrize(
    "words, told",
    [
        ((*SUN, "-o", "a.csv", "--shard", "2/2"), ("--shard is '2/2'", "0/4")),
        ((*SUN, "-o", "a.csv", "--shard", "half"), ("--shard is 'half'", "I/N")),
        ((*PICTURE, "--counters", "--shard", "0/2"), ("--counters",)),
        ((*PICTURE, "--html", "a.html", "--shard", "0/2"), ("--html",)),
        ((*PICTURE, "--plan", "bsah+chcrt:20", "--shard", "0/2"), ("exact plan",)),
        (("merge", "nothing"), ("nothing", "holds no shards")),
    ],
)
def test_bad_input(cli, words, told):
    cli(*words).refused(*told)


SLURM = {"SLURM_ARRAY_TASK_ID": "3", "SLURM_ARRAY_TASK_COUNT": "4", "SLURM_ARRAY_TASK_MIN": "0"}


@pytest.mark.parametrize(
    "text, variables, shard",
    [
        ("auto", SLURM, (3, 4)),
        ("auto", SLURM | {"SLURM_ARRAY_TASK_MIN": "1"}, (2, 4)),
        ("auto/64", SLURM | {"SLURM_ARRAY_TASK_COUNT": "1", "SLURM_ARRAY_TASK_MIN": "3"}, (3, 64)),  # --array=3
        ("auto/8", {"JOB_COMPLETION_INDEX": "7"}, (7, 8)),
    ],
)
def test_shards_of_schedulers(monkeypatch, text, variables, shard):
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert parse_shard(text) == shard


@pytest.mark.parametrize(
    "text, variables, words",
    [
        ("auto", {}, "none of SLURM_ARRAY_TASK_ID, JOB_COMPLETION_INDEX is set; write I/N"),
        ("auto/4", {}, "none of SLURM_ARRAY_TASK_ID, JOB_COMPLETION_INDEX is set; write I/N"),
        ("auto", {"JOB_COMPLETION_INDEX": "1"}, "JOB_COMPLETION_INDEX has no number of tasks; write auto/N"),
        ("auto/4", {"JOB_COMPLETION_INDEX": "4"}, "task 4 of 4; number the tasks 0 to 3"),
        ("auto", SLURM | {"SLURM_ARRAY_TASK_ID": "9"}, "task 9 of 4; number the tasks 0 to 3"),
        ("auto", SLURM | {"SLURM_ARRAY_TASK_ID": "x"}, "SLURM_ARRAY_TASK_ID is 'x'; it must be a whole number"),
        ("auto/0", {"JOB_COMPLETION_INDEX": "0"}, "has no number of tasks"),
        ("auto/x", {"JOB_COMPLETION_INDEX": "0"}, "write I/N with 0 <= I < N"),
    ],
)
def test_schedulers_without_a_shard_are_refused(monkeypatch, text, variables, words):
    for name in ("SLURM_ARRAY_TASK_ID", "JOB_COMPLETION_INDEX"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(at.InputError, match=re.escape(words)):
        parse_shard(text)


def test_a_shard_of_a_scheduler_is_that_shard(run, tmp_path, small_parts, monkeypatch):
    monkeypatch.setenv("JOB_COMPLETION_INDEX", "1")
    assert run("a", *JOBS["sun"], "--shard", "auto/2", "--json").json()["shard"] == "1/2"


def test_frames_of_shards_have_the_exposure_of_the_first(run, tmp_path):
    """Shard 1 has the second frame only: it finds the exposure of the first, although nobody has rendered it yet."""
    words = JOBS["frames"]
    run("a", *words, "--shard", "1/4", "-q")
    run("whole", *words, "-q")
    exposures = [json.loads(note_of(tmp_path / file))["exposed"] for file in ("a/f.05.png", "whole/f.03.png")]
    assert exposures[0] == exposures[1]
    assert not (tmp_path / "a" / "f.03.png").exists()


def test_a_film_is_written_once_all_of_its_frames_exist(run, tmp_path):
    words = ("render", CITY, "--size", "24", "--frames", "0:3", "-o", "f.gif", "--spp", 4)
    run("whole", *words, "-q")
    first = run("a", *words, "--shard", "0/2")
    assert "f.gif is not written" in first.out and not (tmp_path / "a" / "f.gif").exists()
    run("a", *words, "--shard", "1/2", "-q")
    run("a", "merge", shards_of(tmp_path / "a" / "f.gif.frames"), "-q")
    assert (tmp_path / "a" / "f.gif").read_bytes() == (tmp_path / "whole" / "f.gif").read_bytes()


# --- The registry of jobs ---------------------------------------------------------------------------------------------


PAGE = Path(__file__).parents[2] / "docs" / "jobs" / "cluster.md"
IN_THEIR_OWN_TESTS = {"calendar", "pv", "route"}  # whose shards test_sun_calendar.py and its neighbours merge


def studies_below(base):
    """All classes of commands below one."""
    for each in base.__subclasses__():
        yield from studies_below(each)
        yield each


def jobs():
    """Name of a command -> the names of its arguments, of pictures and studies."""
    for each in COMMANDS.values():
        if each.module.startswith(("antumbra.city", "antumbra.cli")):
            each_module = __import__(each.module, fromlist=["_"])
            assert each_module.__name__ == each.module
    modules = {each.__module__: each for each in studies_below(StudyCommand) if hasattr(each, "__dataclass_fields__")}
    found = {name: modules[each.module] for name, each in COMMANDS.items() if each.module in modules}
    found["render"] = inspect.getmodule(COMMANDS["render"].function("render")).RenderArguments
    found["build"] = inspect.getmodule(COMMANDS["build"].function("build")).BuildArguments
    return {name: {each.name for each in fields(kind)} for name, kind in found.items()}


def test_every_job_has_threads_shards_a_cluster_and_a_merge():
    named = jobs()
    assert len(named) == 15 and {"render", "sun", "los", "view-factors", "dataset"} <= named.keys()
    lacking = {name: {"shard", "ray", "merge"} - given for name, given in named.items()}
    assert not any(lacking.values()), lacking


def test_the_documentation_has_a_row_for_every_job():
    rows = set(re.findall(r"^\| `([a-z-]+)` \|", PAGE.read_text(encoding="utf-8"), re.M))
    assert rows == jobs().keys()


def test_the_shards_of_every_job_are_merged_by_a_test():
    assert {words[0] for words in JOBS.values()} | IN_THEIR_OWN_TESTS == jobs().keys()


STUDIES = "bake dataset line_of_sight shadow skyline sun_hours view_factors viewshed visibility_matrix visible_share"


@pytest.mark.parametrize("name", STUDIES.split())
def test_every_study_keeps_its_parts_in_a_folder_or_gives_them_to_an_executor(name):
    assert inspect.signature(getattr(at, name)).parameters["keep"].default is None


@pytest.mark.parametrize("option", ["--shard", "--ray"])
def test_parts_without_a_place_are_refused(cli, option):
    cli("los", "--from", "0,1,8", "--to", "0,1,-8", option, "0/2" if option == "--shard" else "local").refused(
        option, "--output"
    )


@pytest.mark.parametrize("form", ["{}", "-o a.csv --terrain {}", "--sensors raster:{}", "--terrain={}", "{}?band=1"])
def test_a_record_of_shards_reaches_no_server(cli, tmp_path, monkeypatch, form):
    """Whoever wrote the record is not the user."""
    (tmp_path / "web").mkdir()
    write_raster(tmp_path / "web" / "a.tif", hills())
    scene = write_raster(tmp_path / "local.tif", hills())
    with serving(tmp_path / "web", monkeypatch) as server:
        words = form.format(f"{server.url}/a.tif").split()
        words = words if "-" not in form[:1] else [str(scene), *words]
        (tmp_path / "a.shards").mkdir()
        write_shard_record(tmp_path / "a.shards", ["viewshed", *words, "--observer", "100009,449993,99"], 2)
        cli("merge", "a.shards").refused(
            f"a.tif: is read from {server.url}/a.tif, as the record in a.shards says", "--merge a.shards"
        )
        assert not server.requests


def test_each_command_with_work_by_blocks_has_a_memory_limit():
    options = {name: inspect.signature(each.function(name)).parameters for name, each in COMMANDS.items()}
    by_blocks = {name for name, names in options.items() if "shard" in names}
    assert len(by_blocks) > 9 and all("max_memory" in options[name] for name in by_blocks)
