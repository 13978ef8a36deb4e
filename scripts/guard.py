"""Compare this working tree with an earlier commit: the same bits from every plan, and the same speed.

python scripts/guard.py [REVISION] [--rounds N] [--json FILE]

Both trees render fixed frames with every plan and run a few short benchmarks, in alternating processes. The report
lists the frames whose bits or pictures differ, and the ratio of each benchmark's median times, this tree over REVISION
(default: HEAD~1). The exit code is 1 if any bits differ, or if the plans of a tree disagree. Pictures may change on
purpose, and timings depend on the machine's load: judge both yourself.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter

ROOT = Path(__file__).resolve().parents[1]
SIZE, SPP = (192, 144), 16
REPEATS = 7


def digest(*arrays) -> str:
    """A short digest of arrays: their shapes and bytes."""
    sha256 = hashlib.sha256()
    for array in arrays:
        sha256.update(repr((array.shape, array.dtype.str)).encode() + array.tobytes())
    return sha256.hexdigest()[:16]


def scenes() -> Iterator[tuple]:
    """Yield (name, scene, camera, lights) of the fixed frames."""
    import antumbra as at

    for name, count in (("atrium", 20_000), ("city", 50_000), ("forest", 50_000)):
        scene = at.procedural(name, triangles=count)
        yield name, scene, scene.default_camera(*SIZE), standard_lights(scene)
    folder = Path(os.environ.get("ANTUMBRA_SCENES", ROOT.parent / "shared" / "scenes"))
    for name in ("sponza_crytek", "japanese_temple"):
        if (folder / name / "scene.glb").exists():
            scene = at.load(folder / name / "scene.glb")
            yield name, scene, scene.default_camera(*SIZE), standard_lights(scene)


def standard_lights(scene) -> list:
    """A light of each kind, around the scene."""
    import antumbra as at

    lower, upper = scene.bounds
    middle, size = (lower + upper) / 2, float((upper - lower).max())
    up = [0, 0, 1] if scene.up == "z" else [0, 1, 0]
    above = [m + size * u for m, u in zip(middle, up)]
    return [
        scene.default_light(),
        at.PointLight(above),
        at.SphereLight(above, size / 10),
        at.DiskLight(above, up, size / 5),
        at.DirectionalLight([-0.3 - u for u in up], 2.0),
        at.AmbientOcclusion(),
        at.PointLights([[a + size / 9 * k for a in above] for k in range(8)]),
    ]


def plans() -> list[str]:
    """Each method of the registries once, in an otherwise plain plan; `auto` first."""
    try:
        from antumbra.engine import method_registry as methods
    except ImportError:  # an older tree
        from antumbra import methods

    names_of, build = methods.own_methods, ("bsah", "multifrusta")
    alone = lambda name: name == "auto" or not methods.TRACERS[name].builds
    tracers = [name if alone(name) else f"{build[0]}+{name}" for name in names_of("trace")]
    return [
        *tracers,
        *(f"{name}+{build[1]}" for name in names_of("build") if name != build[0]),
        *(f"{build[0]}+{name}+{build[1]}" for name in names_of("optimise")),
        *("+".join((name, *build)) for name in names_of("cull")),
        *(f"{build[0]}+{name}+{build[1]}" for name in names_of("update")),
    ]


def digests() -> dict[str, dict[str, str]]:
    """Frame -> plan -> digest of the bits, and of the picture with `auto`."""
    import numpy as np

    import antumbra as at

    result: dict[str, dict[str, str]] = {}
    rng = np.random.default_rng(1)
    for name, scene, camera, lights in scenes():
        frames = {plan: at.render(scene, camera, lights, spp=SPP, plan=plan) for plan in plans()}
        result[f"{name}, bits"] = {plan: digest(*frame.bits) for plan, frame in frames.items()}
        result[f"{name}, picture"] = {"auto": digest(frames["auto"].image)}
        origins = rng.uniform(*scene.bounds, (20_000, 3))
        directions = rng.normal(size=(20_000, 3))
        hit = scene.closest_hit(origins, directions)
        result[f"{name}, rays"] = {"auto": digest(scene.occluded(origins, directions), hit.face)}
        points = at.visibility(scene, origins[:2000], lights[0], spp=SPP)
        result[f"{name}, points"] = {"auto": digest(points.bits)}
    return result


def benchmarks() -> Iterator[tuple[str, Callable]]:
    """Yield (name, call to time)."""
    import numpy as np

    import antumbra as at

    rng = np.random.default_rng(2)
    for name, scene, camera, lights in scenes():
        renderer = at.Renderer(scene, threads=2)
        yield f"{name}: frame, area light", partial(renderer.render, camera.resized(512, 384), lights[:1], spp=SPP)
        origins, directions = rng.uniform(*scene.bounds, (1_000_000, 3)), rng.normal(size=(1_000_000, 3))
        for n in (1, 100, 10_000, 1_000_000):
            rays = origins[:n].astype(np.float32), directions[:n].astype(np.float32)
            yield f"{name}: occluded, {n:,} rays", partial(scene.occluded, *rays, threads=2)
        yield f"{name}: closest_hit, {n:,} rays", partial(scene.closest_hit, *rays, threads=2)
        yield f"{name}: visibility, 1 point", partial(at.visibility, scene, origins[0], lights[1], spp=1)
        points = origins[:10_000]
        yield f"{name}: visibility, 10,000 points", partial(at.visibility, scene, points, lights[0], spp=SPP)


def times() -> dict[str, float]:
    """Benchmark -> median seconds per call, after three warm-up calls."""
    seconds = {}
    for name, call in benchmarks():
        for _ in range(3):
            call()
        start = perf_counter()
        call()
        calls = max(1, int(0.01 / (perf_counter() - start)))  # each sample takes 10 ms or more
        samples = []
        for _ in range(REPEATS):
            start = perf_counter()
            for _ in range(calls):
                call()
            samples.append((perf_counter() - start) / calls)
        seconds[name] = median(samples)
    return seconds


def run(tree: Path, task: str) -> dict:
    """The result of `digests` or `times` in a new process that imports the package from a tree."""
    environment = {**os.environ, "PYTHONPATH": str(tree / "src")}
    command = [sys.executable, str(Path(__file__).resolve()), "--task", task]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(f"guard: {task} failed in {tree}")
    return json.loads(done.stdout)


def announce(tree: Path) -> None:
    """Write the entry points of a tree beside its package, where they hide those of the installed package."""
    project = tomllib.loads((tree / "pyproject.toml").read_text())["project"]
    lines = []
    for group, points in project.get("entry-points", {}).items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    folder = tree / "src" / "antumbra-0.dist-info"
    folder.mkdir(exist_ok=True)
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: antumbra\nVersion: 0\n")
    (folder / "entry_points.txt").write_text("\n".join(lines) + "\n")


def differences(old: dict, new: dict) -> list[str]:
    """A line for each frame whose plans disagree, or whose digests differ between the trees."""
    lines = []
    for frame, by_plan in new.items():
        odd = [plan for plan, value in by_plan.items() if value != by_plan["auto"]]
        if odd:
            lines.append(f"{frame}: {', '.join(odd)} disagree with auto")
        if frame not in old:
            lines.append(f"{frame}: new")
        elif old[frame]["auto"] != by_plan["auto"]:
            lines.append(f"{frame}: CHANGED")
    return lines


def compare(revision: str, rounds: int) -> tuple[list[str], dict[str, float]]:
    """(differences, benchmark -> ratio of the median times) of this tree to a revision."""
    with TemporaryDirectory() as folder:
        other = Path(folder) / "tree"
        subprocess.run(["git", "-C", ROOT, "worktree", "add", "-q", "--detach", other, revision], check=True)
        announce(other)
        try:
            lines = differences(run(other, "digests"), run(ROOT, "digests"))
            old, new = [], []
            for _ in range(rounds):
                old.append(run(other, "times"))
                new.append(run(ROOT, "times"))
        finally:
            subprocess.run(["git", "-C", ROOT, "worktree", "remove", "--force", other], check=True)
    middle = lambda rows, name: median(row[name] for row in rows)
    return lines, {name: middle(new, name) / middle(old, name) for name in new[0] if name in old[0]} if rounds else {}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revision", nargs="?", default="HEAD~1")
    parser.add_argument("--rounds", type=int, default=3, help="timing processes per tree; 0: bits only")
    parser.add_argument("--json", type=Path, help="also write the result to this file")
    parser.add_argument("--task", choices=("digests", "times"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.task:
        print(json.dumps({"digests": digests, "times": times}[options.task]()))
        return 0
    lines, ratios = compare(options.revision, options.rounds)
    print(*(lines or ["bits and pictures: equal with every plan"]), sep="\n")
    for name, ratio in ratios.items():
        print(f"{ratio:6.2f}  {name}")
    if options.json:
        options.json.write_text(json.dumps({"revision": options.revision, "differences": lines, "ratios": ratios}))
    return int(any("picture" not in line and "new" not in line for line in lines))


if __name__ == "__main__":
    sys.exit(main())
