"""``antumbra doctor``, ``warmup`` and ``plans``: state of the installation, precompilation, registered methods.

`about` returns versions, commit and hardware for the header of results.
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
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..base.errors import InputError
from ..base.extras import EXTRAS
from ..base.wording import counted, some_of
from ..version import VERSION
from ..work.result_summary import duration
from . import console
from .completion import completion_of
from .console import ProgressDisplay
from .options import Json, Quiet

if TYPE_CHECKING:
    from ..devices.device_list import DeviceInfo

# --- Versions, commit and hardware ------------------------------------------------------------------------------------


def about() -> dict[str, str | int]:
    """Name -> version, commit, or hardware. `commit` is present only in a git checkout."""
    from ..kernels.toolchain.kernel_loading import has_compiler

    facts: dict[str, str | int] = {"antumbra": VERSION}
    if commit := _commit():
        facts["commit"] = commit
    facts |= {"python": platform.python_version(), "numpy": version("numpy")}
    facts |= {"numba": version("numba")} if has_compiler() else {}
    return facts | {"system": f"{platform.system()} {platform.release()}", **_machine()}


def _machine() -> dict[str, str | int]:
    from ..kernels.parallel import thread_count
    from ..kernels.processor import level

    processor = f"{_model() or platform.machine()} (kernels for {level()})"
    return {"processor": processor, "cores": thread_count(None), **_machine_memory()}


def _model() -> str:
    """The vendor's name of the processor; empty if unknown."""
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
    """The commit of the checkout, with "-dirty" after local changes; empty if git does not track this file."""
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


# --- ``antumbra doctor`` ----------------------------------------------------------------------------------------------


_EXTRA = re.compile(r"^([\w.-]+)[^;]*;.*extra == [\"']([\w-]+)[\"']")
_CORE = "numpy", "pillow", "typer", "rich"


def doctor(
    ray: Annotated[
        str | None,
        typer.Option(help="Also report each node of a Ray cluster.", metavar="ADDRESS|local", show_default=False),
    ] = None,
    json: Json = False,
) -> None:
    """Check this installation.

    It shows versions, the processor, kernels on disk, optional packages and devices. Each device answers thousands of
    queries that are hard to decide. The exit code is 1 if any answer is wrong. Include the output in bug reports.

    \b
    Examples
      antumbra doctor
      antumbra doctor --json
      antumbra doctor --ray auto
    """
    check = _check()  # first: it compiles the kernels that it needs
    results: dict[str, Any] = {
        **about(),
        **_versions(),
        **_memory(),
        "kernels": _kernels(),
        "extras": _extras(),
        "devices": _devices(),
        "check": check,
    }
    if ray is not None:
        results["nodes"] = _nodes(ray)
    if json:
        console.print_json(results)
    else:
        console.print_fields(_lines(results))
    if not results["check"]["right"] or any(device["wrong"] for device in results["devices"]):
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


def _nodes(address: str) -> list[dict[str, Any]]:
    """The resources of each node of a cluster; see `cluster.ray_workers.survey`."""
    from ..cluster.ray_executor import connected
    from ..cluster.ray_workers import survey

    with connected(address) as cluster:
        return survey(cluster)


def _node_text(node: dict[str, Any]) -> str:
    if "error" in node:
        return f"{node['node']}: {node['error']}"
    memory = "" if node["memory"] is None else f"{node['memory']:.0f} GiB of memory, "
    kernels = f"{counted(node['missing'], 'kernel')} missing" if node["missing"] else "all kernels compiled"
    disk = f"{node['room']:.0f} GiB of disk space"
    return f"{node['node']}: {counted(node['cores'], 'core')}, {memory}{disk}, {node['antumbra']}, {kernels}"


def _kernels() -> dict[str, Any]:
    """Where compiled kernels are, in the package or in the user's cache, and how many of the example calls' exist."""
    from ..engine.precompilation import missing_of
    from ..kernels.processor import LIBRARIES
    from ..kernels.toolchain import kernel_manifest
    from ..kernels.toolchain.kernel_cache import user_cache
    from ..kernels.toolchain.kernel_library import installed_library

    kernels = kernel_manifest.read_manifests(kernel_manifest.MANIFEST).kernels
    folder = user_cache().path if installed_library() is None else LIBRARIES
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
        if match is None or match[2] not in EXTRAS or match[1] == "antumbra":
            continue
        try:
            version = importlib.metadata.version(match[1])
        except importlib.metadata.PackageNotFoundError:
            version = None
        extras.setdefault(match[2], {})[match[1]] = version
    return extras


def _devices() -> list[dict[str, Any]]:
    """Each device with the result of its self-test, or why it cannot be used. Without a driver, the kind alone."""
    from ..devices.device_list import list_devices

    return [_device(info) for info in list_devices()]


def _device(info: "DeviceInfo") -> dict[str, Any]:
    from ..devices.device_list import open_device
    from ..techniques.culling import device_culling  # noqa: F401, its kernels are tested too
    from ..trace.device.self_test import run_self_test

    fields: dict[str, Any] = {"name": info.name, "model": info.model, "driver": info.driver, "problem": info.problem}
    result: tuple[int | None, int | None] = None, None
    if info.problem is None:
        try:
            result = run_self_test(open_device(info.name))
        except InputError as error:
            fields["problem"] = str(error)
    return fields | dict(zip(("answers", "wrong"), result))


def _device_text(device: dict[str, Any]) -> str:
    about = f"{device['model']}, {device['driver']}: " if device["model"] else ""
    if device["problem"] is not None:
        return f"{about}{device['problem']}"
    if device["wrong"]:
        wrong = some_of(device["wrong"], device["answers"], "answer", "are")
        return f"{about}{wrong} WRONG: update the driver, or report this"
    return f"{about}{counted(device['answers'], 'answer', 'are')} right"


def _check() -> dict[str, Any]:
    """Query which of two lamps points on both sides of a wall see, with the default plan; and render a picture."""
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


def _lines(results: dict[str, Any]) -> Iterator[tuple[str, str]]:
    kernels, check = results["kernels"], results["check"]
    for name, value in results.items():
        if name not in ("kernels", "extras", "devices", "check", "nodes"):
            yield name, str(value)
    remedy = "; antumbra warmup compiles the rest" if kernels["missing"] else ""
    yield "kernels", f"{kernels['compiled']} compiled, {kernels['missing']} missing{remedy}"
    yield "", kernels["folder"] + ("" if kernels["writable"] else " (not writable: set ANTUMBRA_CACHE to a folder)")
    for extra, packages in results["extras"].items():
        missing = [name for name, version in packages.items() if version is None]
        there = ", ".join(f"{name} {version}" for name, version in packages.items() if version is not None)
        remedy = f"pip install 'antumbra[{extra}]' adds {', '.join(missing)}, for {EXTRAS[extra]}"
        yield f"[{extra}]", remedy if missing else there
    for device in results["devices"]:
        yield device["name"], _device_text(device)
    for node in results.get("nodes", []):
        yield "node", _node_text(node)
    verdict = "right" if check["right"] else "WRONG: please report this"
    yield "query", f"1000 points, 2 lamps: {verdict}"
    yield "picture", f"{check['mrays_per_second']:.1f} million rays per second with {check['plan']}"


# --- ``antumbra warmup`` ----------------------------------------------------------------------------------------------


def warmup(
    plan: Annotated[
        list[str] | None,
        typer.Option(
            help="Compile only for this plan; may be repeated.  [default: all methods]",
            autocompletion=completion_of("plan"),
            metavar="PLAN",
            show_default=False,
        ),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Compile all kernels ahead of time.

    They are stored on disk, and the plan auto is calibrated. Without this command, each kernel is compiled on first
    use, once per machine and version, and auto predicts times from measurements of another machine.

    \b
    Examples
      antumbra warmup
      antumbra warmup --plan bsah+single
    """
    from ..engine.calibration import calibrate
    from ..engine.plan import covering_plans, parse_plan
    from ..engine.precompilation import precompile_all
    from ..kernels.toolchain.kernel_cache import user_cache
    from ..work.warm_ups import all_examples

    plans = [parse_plan(text) for text in plan] if plan else covering_plans()
    examples = all_examples(plans)
    start = perf_counter()
    with ProgressDisplay(quiet):
        compiled = precompile_all(examples)
        measured = calibrate()._asdict() if any(plan.tracer.chooses for plan in plans) else None
    seconds, folder = perf_counter() - start, str(user_cache().path)
    if json:
        names = [example.name for example in examples]
        console.print_json(
            {"jobs": names, "compiled": compiled, "folder": folder, "seconds": seconds, "machine": measured}
        )
    elif not quiet:
        time = duration(seconds)
        print(
            f"kernels of {counted(len(examples), 'job', 'are')} ready, {compiled} newly compiled, in {folder} ({time})"
        )


# --- ``antumbra plans`` -----------------------------------------------------------------------------------------------


def plans(
    papers: Annotated[bool, typer.Option("--papers", help="Also list variants of papers, and baselines.")] = False,
    json: Json = False,
) -> None:
    """List the methods, and how they form plans.

    Each method is listed with a description and its paper. A plan is written builder+tracer, with an optional culler,
    optimiser or updater. The tracer cones uses no BVH, so its plans have no builder. All exact plans give the same
    bits; they differ in speed. Plans can also use the methods of --papers. The options of cones can be combined, as in
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
            ("a plan", f"{order}; only builder and tracer are required, and cones and auto have no builder"),
            ("default", DEFAULT_PLAN),
        ]
    )
