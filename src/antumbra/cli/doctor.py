"""``antumbra doctor``: says whether this installation is in order, for bug reports and for puzzled users."""

import importlib.metadata
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from time import perf_counter
from typing import Annotated, Any

import typer

from . import report
from .options import Json

_FOR_DEVELOPERS = ("docs", "test", "dev", "all-peers")
_EXTRA = re.compile(r"^([\w.-]+)[^;]*;.*extra == [\"']([\w-]+)[\"']")
_CORE = "numba", "llvmlite", "numpy", "scipy", "trimesh", "pillow", "OpenEXR", "typer", "rich"


def doctor(
    ray: Annotated[
        str | None,
        typer.Option(help="Also say what each node of a Ray cluster has.", metavar="ADDRESS|local", show_default=False),
    ] = None,
    json: Json = False,
) -> None:
    """Check this installation: versions, processor, kernels on disk, optional packages, and a small query.

    The exit code is 1 if the query has a wrong answer. Bug reports should contain what it prints.

    \b
    Examples
      antumbra doctor
      antumbra doctor --json
      antumbra doctor --ray auto
    """
    from .about import about

    found: dict[str, Any] = {
        **about(),
        **_versions(),
        **_memory(),
        "kernels": _kernels(),
        "extras": _extras(),
        "check": _check(),
    }
    if ray is not None:
        found["nodes"] = _nodes(ray)
    if json:
        report.print_json(found)
    else:
        report.print_fields(_lines(found))
    if not found["check"]["right"]:
        raise typer.Exit(1)


def _versions() -> dict[str, str]:
    return {name: importlib.metadata.version(name) for name in _CORE}


def _memory() -> dict[str, str]:
    room = {"room for temporary files": f"{shutil.disk_usage(tempfile.gettempdir()).free / 2**30:.1f} GiB"}
    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return room
    return {"free memory": f"{free / 2**30:.1f} GiB", **room}


def _nodes(address: str) -> list[dict]:
    """What the nodes of a cluster have; see `cluster.survey`."""
    from ..cluster.engine import connected
    from ..cluster.survey import survey

    with connected(address) as cluster:
        return survey(cluster)


def _node_text(node: dict) -> str:
    if "error" in node:
        return f"{node['host']}: {node['error']}"
    memory = "" if node["memory"] is None else f"{node['memory']:.0f} GiB of memory, "
    kernels = f"{node['missing']} kernels missing" if node["missing"] else "all kernels compiled"
    return (
        f"{node['host']}: {node['cores']} cores, {memory}{node['room']:.0f} GiB of room, {node['antumbra']}, {kernels}"
    )


def _kernels() -> dict:
    """Where compiled kernels are kept, and how many of those that jobs need are there."""
    from ..engine.precompilation import missing_of
    from ..kernels import needs
    from ..kernels.loading import user_cache

    wanted, folder = needs.read(needs.FILE).kernels, user_cache().path
    above = next(path for path in (folder, *folder.parents) if path.exists())
    missing = len(missing_of(wanted))
    return {
        "folder": str(folder),
        "writable": os.access(above, os.W_OK),
        "compiled": len(wanted) - missing,
        "missing": missing,
    }


def _extras() -> dict[str, dict[str, str | None]]:
    """Extra -> its packages with their versions; None: not installed."""
    found: dict[str, dict[str, str | None]] = {}
    for line in importlib.metadata.requires("antumbra") or []:
        match = _EXTRA.match(line)
        if match is None or match[2] in _FOR_DEVELOPERS or match[1] == "antumbra":
            continue
        try:
            version = importlib.metadata.version(match[1])
        except importlib.metadata.PackageNotFoundError:
            version = None
        found.setdefault(match[2], {})[match[1]] = version
    return found


def _check() -> dict:
    """Ask points on both sides of a wall which of two lamps they see, by the default plan; and render a picture."""
    import numpy as np

    from .. import PointLight, Scene, procedural, render, visibility

    start = perf_counter()
    wall = np.array([[0, -9, -9], [0, 9, -9], [0, 9, 9], [0, -9, -9], [0, 9, 9], [0, -9, 9]], float)
    sides = np.where(np.arange(1000) % 2, 1.0, -1.0)
    points = np.column_stack([sides, np.random.default_rng(1).uniform(-5.0, 5.0, (1000, 2))])
    lamps = [PointLight((2, 0, 0)), PointLight((-2, 0, 0))]
    seen = visibility(Scene.from_arrays(wall), points, lamps, spp=1).seen
    right = bool((seen == np.column_stack([sides > 0, sides < 0])).all())
    scene = procedural("atrium", triangles=20_000)
    frame = render(scene, scene.cameras[0].resized(256, 256))
    speed = frame.rays / frame.timings["trace"] / 1e6
    return {"right": right, "mrays_per_second": speed, "plan": frame.plan, "seconds": perf_counter() - start}


def _lines(found: dict) -> Iterator[tuple[str, str]]:
    kernels, check = found["kernels"], found["check"]
    for name, value in found.items():
        if name not in ("kernels", "extras", "check", "nodes"):
            yield name, str(value)
    cure = "; antumbra warmup compiles the rest" if kernels["missing"] else ""
    yield "kernels", f"{kernels['compiled']} compiled, {kernels['missing']} missing{cure}"
    yield "", kernels["folder"] + ("" if kernels["writable"] else " (not writable: set ANTUMBRA_CACHE to a folder)")
    for extra, packages in found["extras"].items():
        lacking = [name for name, version in packages.items() if version is None]
        there = ", ".join(f"{name} {version}" for name, version in packages.items() if version is not None)
        yield f"[{extra}]", there if not lacking else f"pip install 'antumbra[{extra}]' adds {', '.join(lacking)}"
    for node in found.get("nodes", []):
        yield "node", _node_text(node)
    verdict = "right" if check["right"] else "WRONG: please report this"
    yield "query", f"1000 points, 2 lamps: {verdict}"
    yield "picture", f"{check['mrays_per_second']:.1f} million rays a second by {check['plan']}"
