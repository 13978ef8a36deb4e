"""Imports of commands: the help must not wait for Numba, and a picture must not wait for modules it does not need."""

import subprocess
import sys

import pytest

from antumbra.base.command_registry import COMMANDS

NEVER = {"scipy", "trimesh", "pydantic", "hypothesis", "matplotlib", "OpenEXR"}
SLOW = {"numpy.ma", "rich", "antumbra.lab.papers", "antumbra.techniques.rayhierarchy.ray_hierarchy"}
EXTRAS = {"scipy", "OpenEXR", "matplotlib", "pvlib", "pandas", "pyproj", "mapbox_earcut", "pyarrow", "rasterio"}
EXTRAS |= {"xatlas", "imageio_ffmpeg", "viser", "websockets", "ray", "DracoPy", "playwright", "pyopencl"}  # no compiler


def imported(*arguments: str, cwd) -> set[str]:
    """The names of the modules that a run of the command imports."""
    script = (
        "import pathlib, sys; from antumbra.cli import main; code = main(sys.argv[1:]);"
        "pathlib.Path('modules').write_text(' '.join(sys.modules)); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return set((cwd / "modules").read_text().split())


def test_a_command_imports_no_other(tmp_path):
    names = {name for name in imported("render", "--help", cwd=tmp_path) if name.endswith(("_command", "_commands"))}
    assert names == {"antumbra.cli.render_command"}
    listed = {name for name in imported("--help", cwd=tmp_path) if name in {each.module for each in COMMANDS.values()}}
    assert not listed


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["render", "--help"]])
def test_help_imports_nothing_heavy(arguments, tmp_path):
    names = imported(*arguments, cwd=tmp_path)
    assert not names & {"numba", "PIL", "rich.table", *NEVER - {"pydantic"}}


@pytest.mark.parametrize("scene", [[], ["procedural:atrium?triangles=2000"]], ids=["default", "named"])
def test_rendering_a_png_imports_nothing_needless(scene, tmp_path):
    for _ in range(2):  # the first run may have to compile
        names = imported("render", *scene, "--size", "32", cwd=tmp_path)
    assert "llvmlite" in names and not names & {"numba", *NEVER, *SLOW}


def test_commands_run_without_extras(tmp_path):
    script = (
        "import sys; sys.modules.update(dict.fromkeys(sys.argv[1].split(',')));"
        "from antumbra.cli import main; sys.exit(main(sys.argv[2:]))"
    )
    scene, size = "procedural:atrium?triangles=1000", ("--size", "24")
    commands = [
        ["render", *size, "--counters", "--filter", "--sampler", "sobol", "--light", "point:0,3,0@9", "--vpl", "16"],
        ["render", scene, *size, "--frames", "0:1", "-o", "film.gif"],
        ["info", scene, "--json"],
        ["scenes", "atrium", "--triangles", "1000", "-o", "a.ply"],
        ["render", "a.ply", *size, "-o", "a.png"],
        ["viewshed", scene, "--observer", "0,1.7,0", "--sensors", "grid:2", "-o", "seen.png"],
        ["matrix", scene, "--sensors", "grid:4", "-o", "seen.npy", "--sparse", "seen.npz"],
    ]
    for command in commands:
        done = subprocess.run(
            [sys.executable, "-c", script, ",".join(sorted(EXTRAS)), *command],
            capture_output=True,
            text=True,
            cwd=tmp_path,
        )
        assert done.returncode == 0, (command, done.stderr)
    names = {"antumbra.png", "film.gif", "a.ply", "a.png", "seen.png", "seen.npy", "seen.npz"}
    assert names <= {path.name for path in tmp_path.iterdir()}


def test_asking_rays_imports_nothing_needless(tmp_path):
    script = (
        "import sys, antumbra as at;"
        "blocked = at.procedural('atrium', triangles=2000).occluded([0, 1.5, 0], [[0, 1, 0], [0, 0, 1]]);"
        "print(*sys.modules)"
    )
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    assert not set(done.stdout.split()) & {"numba", "typer", "rich", "PIL", *NEVER}
