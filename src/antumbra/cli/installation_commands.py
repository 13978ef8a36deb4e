"""``antumbra doctor``, ``warmup`` and ``plans``: state of the installation, precompilation, registered methods.

`about` gives versions, commit and hardware for the header of results.
"""

import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import typer

from ..version import VERSION as __version__
from . import console
from .console import ProgressDisplay
from .options import Json, Quiet

# --- Versions, commit and hardware, for the header of results ---------------------------------------------------------


def about() -> dict[str, str | int]:
    """Name -> version, commit, or part of the machine. `commit` is there only in a checkout of git."""
    facts: dict[str, str | int] = {"antumbra": __version__}
    if commit := _commit():
        facts["commit"] = commit
    facts |= {"python": platform.python_version(), "numpy": version("numpy"), "numba": version("numba")}
    return facts | {"system": f"{platform.system()} {platform.release()}", **_machine()}


def _machine() -> dict[str, str | int]:
    import llvmlite.binding as llvm

    from ..kernels.machine_code import level
    from ..kernels.parallel import thread_count

    processor = f"{_model() or platform.machine()} ({llvm.get_host_cpu_name()}, kernels for {level()})"
    return {"processor": processor, "cores": thread_count(None), **_machine_memory()}


def _model() -> str:
    """The processor's name by its maker, if the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def _machine_memory() -> dict[str, str]:
    try:
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        return {}
    return {"memory": f"{size / 2**30:.0f} GiB"}


def _commit() -> str:
    """The commit of this file, with "-dirty" if files have changed since; empty if git does not know the file."""
    file = Path(__file__)
    if not _git(file.parent, "ls-files", file.name):
        return ""
    return _git(file.parent, "describe", "--always", "--dirty", "--abbrev=12", "--exclude=*")


def _git(folder: Path, *words: str) -> str:
    settings = {**os.environ, "GIT_OPTIONAL_LOCKS": "0"}
    try:
        done = subprocess.run(
            ["git", "-C", str(folder), *words], env=settings, capture_output=True, text=True, timeout=10
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


# --- ``antumbra doctor``: says whether this installation is in order, for bug reports and for puzzled users -----------


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

    results: dict[str, Any] = {
        **about(),
        **_versions(),
        **_memory(),
        "kernels": _kernels(),
        "extras": _extras(),
        "check": _check(),
    }
    if ray is not None:
        results["nodes"] = _nodes(ray)
    if json:
        console.print_json(results)
    else:
        console.print_fields(_lines(results))
    if not results["check"]["right"]:
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
    """What the nodes of a cluster have; see `cluster.ray_workers`."""
    from ..cluster.ray_executor import connected
    from ..cluster.ray_workers import survey

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
    from ..kernels.toolchain import kernel_manifest as needs
    from ..kernels.toolchain.kernel_cache import user_cache

    kernels, folder = needs.read_manifests(needs.MANIFEST).kernels, user_cache().path
    above = next(path for path in (folder, *folder.parents) if path.exists())
    missing = len(missing_of(kernels))
    return {
        "folder": str(folder),
        "writable": os.access(above, os.W_OK),
        "compiled": len(kernels) - missing,
        "missing": missing,
    }


def _extras() -> dict[str, dict[str, str | None]]:
    """Extra -> its packages with their versions; None: not installed."""
    extras: dict[str, dict[str, str | None]] = {}
    for line in importlib.metadata.requires("antumbra") or []:
        match = _EXTRA.match(line)
        if match is None or match[2] in _FOR_DEVELOPERS or match[1] == "antumbra":
            continue
        try:
            version = importlib.metadata.version(match[1])
        except importlib.metadata.PackageNotFoundError:
            version = None
        extras.setdefault(match[2], {})[match[1]] = version
    return extras


def _check() -> dict:
    """Ask points on both sides of a wall which of two lamps they see, by the default plan; and render a picture."""
    import numpy as np

    from .. import PointLight, Scene, procedural, render, visibility

    start = perf_counter()
    wall = np.array([[0, -9, -9], [0, 9, -9], [0, 9, 9], [0, -9, -9], [0, 9, 9], [0, -9, 9]], float)
    sides = np.where(np.arange(1000) % 2, 1.0, -1.0)
    points = np.column_stack([sides, np.random.default_rng(1).uniform(-5.0, 5.0, (1000, 2))])
    lamps = [PointLight((2, 0, 0)), PointLight((-2, 0, 0))]
    bits = visibility(Scene.from_arrays(wall), points, lamps, spp=1).seen
    right = bool((bits == np.column_stack([sides > 0, sides < 0])).all())
    scene = procedural("atrium", triangles=20_000)
    frame = render(scene, scene.cameras[0].resized(256, 256))
    speed = frame.rays / frame.timings["trace"] / 1e6
    return {"right": right, "mrays_per_second": speed, "plan": frame.plan, "seconds": perf_counter() - start}


def _lines(results: dict) -> Iterator[tuple[str, str]]:
    kernels, check = results["kernels"], results["check"]
    for name, value in results.items():
        if name not in ("kernels", "extras", "check", "nodes"):
            yield name, str(value)
    cure = "; antumbra warmup compiles the rest" if kernels["missing"] else ""
    yield "kernels", f"{kernels['compiled']} compiled, {kernels['missing']} missing{cure}"
    yield "", kernels["folder"] + ("" if kernels["writable"] else " (not writable: set ANTUMBRA_CACHE to a folder)")
    for extra, packages in results["extras"].items():
        lacking = [name for name, version in packages.items() if version is None]
        there = ", ".join(f"{name} {version}" for name, version in packages.items() if version is not None)
        yield f"[{extra}]", there if not lacking else f"pip install 'antumbra[{extra}]' adds {', '.join(lacking)}"
    for node in results.get("nodes", []):
        yield "node", _node_text(node)
    verdict = "right" if check["right"] else "WRONG: please report this"
    yield "query", f"1000 points, 2 lamps: {verdict}"
    yield "picture", f"{check['mrays_per_second']:.1f} million rays a second by {check['plan']}"


# --- ``antumbra warmup``: compiles all kernels now, so that none compiles later ---------------------------------------


def warmup(
    plan: Annotated[
        list[str] | None,
        typer.Option(
            help="Only for this plan; may be repeated.  [default: all methods]",
            metavar="PLAN",
            show_default=False,
        ),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compile all kernels now and keep them on disk, and measure this machine.

    Otherwise each kernel is compiled when it is first used, once for each machine and version. The plan auto predicts
    times by what is measured here; otherwise by figures of another machine.

    \b
    Examples
      antumbra warmup
      antumbra warmup --plan bsah+single
    """
    from ..engine.calibration import calibrate
    from ..engine.plan import covering_plans, parse_plan
    from ..engine.precompilation import precompile_all
    from ..jobs.job_kernels import all_jobs
    from ..kernels.toolchain.kernel_cache import user_cache

    plans = [parse_plan(text) for text in plan] if plan else covering_plans()
    jobs = all_jobs(plans)
    start = perf_counter()
    with ProgressDisplay(quiet):
        compiled = precompile_all(jobs)
        measured = calibrate()._asdict() if any(plan.tracer.chooses for plan in plans) else None
    seconds, folder = perf_counter() - start, str(user_cache().path)
    if json:
        names = [job.name for job in jobs]
        console.print_json(
            {"jobs": names, "compiled": compiled, "folder": folder, "seconds": seconds, "machine": measured}
        )
    elif not quiet:
        print(
            f"kernels of {len(jobs)} jobs are ready, {compiled} of them new, in {folder} ({console.duration(seconds)})"
        )


# --- ``antumbra plans``: lists the registered methods -----------------------------------------------------------------


def plans(
    papers: Annotated[
        bool, typer.Option("--papers", help="Also the methods that exist to reproduce a paper, or to be compared with.")
    ] = False,
    json: Json = False,
) -> None:
    """List the methods and the plans made of them.

    Each method has a description and a paper. A plan is written builder+tracer, with an optional culler, optimiser or
    updater. The tracer cones uses no BVH, so its plans have no builder. All plans give the same bits and differ in
    speed. Plans can name the methods of --papers like any others. The options of cones can be combined, as in
    cones:spheres:sorted.

    \b
    Examples
      antumbra plans
      antumbra plans --papers
      antumbra render --plan bsah+single
      antumbra render --plan grid32+lbvh+multifrusta
      antumbra render --plan cones
    """
    from ..engine.method_registry import KINDS
    from ..engine.plan import DEFAULT_PLAN, all_plans, names_of

    names = names_of(papers)
    methods = [
        {"kind": kind, "name": name, "description": registry[name].description, "paper": registry[name].paper}
        for field, (kind, registry) in KINDS.items()
        for name in names[field]
    ]
    if json:
        written = [str(plan) for plan in all_plans(papers)]
        console.print_json({"methods": methods, "plans": written, "default": DEFAULT_PLAN})
        return
    console.print_table(("kind", "name", "what it does", "paper"), [tuple(m.values()) for m in methods])
    order = "+".join(kind for kind, _ in KINDS.values())
    console.print_fields(
        [
            ("a plan", f"{order}, of which only builder and tracer are needed; no builder for cones, or for auto"),
            ("default", DEFAULT_PLAN),
        ]
    )
