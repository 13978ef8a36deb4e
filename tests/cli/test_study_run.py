"""The steps that the commands of all studies share."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

import antumbra as at
from antumbra.city.sun.sun_command import SunCommand
from antumbra.city.sun.sun_options import SunOptions
from antumbra.cli.scene_arguments import parse_scene
from antumbra.cli.study_run import StudyRun
from antumbra.work.result_summary import Summary, SummaryTable


def arguments(**given):
    return SimpleNamespace(**{"json": False, "quiet": False, **given})


def test_a_run_knows_its_time_and_its_files(tmp_path):
    with StudyRun(arguments()) as run:
        assert run.timed(lambda: 5 - 3) == 2
        run.save(lambda path: path.write_text("done"), [tmp_path / "a", tmp_path / "b"])
        run.save(lambda path: pytest.fail("there is no file to write"), [])
    assert run.seconds > 0.0 and (tmp_path / "b").read_text() == "done"
    assert run.written == [str(tmp_path / name) for name in "ab"]
    time, *files = run.rows()
    assert time[0] == "time" and files == [("written", path) for path in run.written]
    run.seconds = 2.0
    assert run.rows(3_000_000)[0] == ("time", "2.00 s, 1.5 million rays/s")
    run.traced = 1 / 3  # the rest was found done
    assert run.rows(3_000_000)[0] == ("time", "2.00 s, 0.5 million rays/s")
    assert run.rows(2_000_000)[0] == ("time", "2.00 s, 666,667 rays")  # mostly preparation, so no speed
    run.traced = 0.0
    assert run.rows(2_000_000)[0] == ("time", "2.00 s")


@pytest.mark.parametrize("given, out", [({"json": True, "quiet": True}, "json"), ({"quiet": True}, ""), ({}, "text")])
def test_a_report_is_json_or_text_or_nothing(capsys, given, out):
    assert StudyRun(arguments(**given)).report(Summary({"n": 1}, [("points", "1")]), None) == 0
    said = capsys.readouterr().out
    assert json.loads(said) == {"n": 1} if out == "json" else said.split() == (["points", "1"] if out else [])


def test_a_scene_in_a_store_is_opened(tmp_path):
    at.build_store(at.procedural("atrium", triangles=1000), tmp_path / "a.antumbra")
    spec, run = parse_scene(str(tmp_path / "a.antumbra")), StudyRun(arguments(quiet=True))
    scenes = run.open(spec)
    assert scenes.planted is scenes.bare and scenes.bare.n_triangles == at.load(tmp_path / "a.antumbra").n_triangles


def test_a_node_gets_the_study_as_an_object_with_its_own_paths_and_threads(tmp_path):
    options = SunOptions(days="2026-03-21", epw=tmp_path / "a.epw")
    sun = SunCommand(scene="city.json?lod=2.2", options=options, output=[tmp_path / "a.csv"], matrix=tmp_path / "m.npy")
    there = sun.on_node({"scene": "/n/x.json", "epw": "/n/y.epw"}, 3)
    assert there.scene == "/n/x.json?lod=2.2" and there.options.epw == Path("/n/y.epw")
    assert there.output == [Path("a.csv")] and there.matrix == Path("m.npy") and there.quiet
    assert there.options.threads == 3 and there.options.days == options.days
    assert sun.on_node({}, 3) == replace(there, scene=sun.scene, options=replace(options, threads=3))
    own = replace(sun, options=replace(options, threads=2))
    assert own.on_node({}, 3).options.threads == 2


def test_outputs_have_a_default_unless_another_file_is_asked_for():
    sun = SunCommand(scene="city.json", options=SunOptions(days="2026-03-21"))
    assert sun.paths("output") == [Path("city-sun.png")] and sun.paths("map") == sun.paths("matrix") == []
    assert replace(sun, map=[Path("a.pdf")]).paths("output") == []
    assert replace(sun, output=[Path("a.tif")]).paths("output") == [Path("a.tif")]


def test_a_table_shown_beside_a_summary_may_come_first(capsys):
    for leads in (True, False):
        table = SummaryTable(("name", "area"), [("roof", "7")], leads=leads)
        StudyRun(arguments()).report(Summary({}, [("points", "1")], table=table), None)
        said = capsys.readouterr().out
        assert (said.index("roof") < said.index("points")) is leads
