"""Whole frames of animated scenes, from evaluation to the shaded picture: ours, and frames rendered with Embree.

    python benchmarks/dynamic.py [scene ...] [--plans PLAN ...] [--threads N ...] [--frames N] [--rounds N]

A scene is bart_robots or synthetic_garden_foxes ($ANTUMBRA_SCENES), or a file that `antumbra.load` reads. Camera and
small square light come from its info.json.

Timed for ours: `Renderer.render` without anti-aliasing, from the call to the picture.

Timed for the peer: our evaluation; Embree's build or refit; primary rays, receivers and shadow rays; our visibility
fractions and our shading. Rays are generated and traced in compiled loops on all threads, to the same light samples.
Copying vertices into Embree's buffer and generating the light samples are not timed.

Every tracing mode is tried on one frame, then every build with the two fastest modes. The two fastest combinations
enter the rounds, where ours and the peer's render the frames alternately. The ratio compares the frame rates at the
median frame time, ours over the peer's fastest.

`differs` counts the pixels of all frames whose visibility fraction differs from our first plan's. Embree and receiver
offsets are subject to rounding; our plans all agree.
"""

import argparse
import statistics
from functools import cache
from typing import NamedTuple

import numpy as np

from antumbra.engine.plan import DEFAULT_PLAN
from antumbra.picture.frame import PHASES
from antumbra.picture.irradiance import irradiance
from antumbra.picture.renderer import Renderer
from antumbra.picture.shading import Illumination, ambient_light, shade
from antumbra.query.shadow_query import fraction_lit
from common import has_embree
from comparison import compare, options_of, progress, start
from peers import embree
from peers.embree_frames import ORDERS, Primary, Shadow, light_points, primary, shadows
from peers.ray_contest import CLOCKS, OURS
from views import MOVING, Moving, moving_views

FPS = 24
EMBREE = "Embree"
BUILDS = [(quality, flags, False) for quality in ("low", "medium", "high") for flags in (0, embree.DYNAMIC)]
BUILDS += [(quality, embree.DYNAMIC, True) for quality in ("low", "medium")]  # (quality, flags, whether to refit)


class FrameMode(NamedTuple):
    """How Embree renders a frame."""

    build: tuple[str, int, bool]  # one of BUILDS
    primary: Primary
    shadow: Shadow

    def __str__(self) -> str:
        quality, flags, refit = self.build
        how = f"refit of {quality}" if refit else f"{quality}{' dynamic' if flags else ''}"
        return f"{how}, {self.primary}, {self.shadow}"


class Result(NamedTuple):
    """One frame: seconds of each phase, and the fraction of the light visible from each pixel."""

    seconds: dict[str, float]  # phase -> seconds
    visibility: np.ndarray  # (H, W) float32


class Ours:
    """One of our plans, with a renderer that keeps its state between frames."""

    family = OURS

    def __init__(self, plan: str, view: Moving, threads: int, spp: int, clock):
        self.name, self.view, self.spp, self.clock = plan, view, spp, clock
        self.renderer = Renderer(view.scene, plan, threads)

    def frame(self, moment: float) -> Result:
        before = self.clock()
        frame = self.renderer.render(self.view.camera, self.view.light, spp=self.spp, time=moment, antialias=False)
        return Result({**frame.timings, "total": self.clock() - before}, frame.visibility[0])

    def close(self) -> None:
        pass


class EmbreeFrames:
    """Embree, with its scene."""

    family = EMBREE

    def __init__(self, mode: FrameMode, device, view: Moving, threads: int, spp: int, clock):
        self.mode, self.view, self.threads, self.spp, self.clock = mode, view, threads, spp, clock
        quality, flags, self.refit = mode.build
        self.scene = embree.EmbreeScene(device, view.scene.triangles().vertices, quality=quality, flags=flags)
        self.lights = light_points(view.light, view.scene.origin, spp)

    @property
    def name(self) -> str:
        return str(self.mode)

    def frame(self, moment: float) -> Result:
        seconds, last = dict.fromkeys(PHASES, 0.0), self.clock()

        def lap(phase):
            nonlocal last
            now = self.clock()
            seconds[phase] += now - last
            last = now

        view, light = self.view, self.view.light
        triangles = view.scene.triangles(moment, self.threads)
        lap("evaluate")
        self.scene.fill(triangles.vertices)
        last = self.clock()  # not timed: a program written for Embree would evaluate into its buffer
        self.scene.build_again(self.refit)
        lap("build")
        rays = view.camera.rays(triangles.origin)
        hits = primary(self.scene, triangles, rays, self.mode.primary, self.threads)
        lap("gbuffer")
        bits = shadows(self.scene, hits, self.lights, self.mode.shadow, self.threads)
        lap("trace")
        visibility = fraction_lit(bits, self.spp, self.threads)
        lap("filter")
        arrived = [irradiance(hits.gbuffer, light.patch(triangles.origin, 1.0), light.domain, threads=self.threads)]
        ambient = ambient_light(hits.gbuffer, [light], arrived)
        colour, up = triangles.colour, view.scene.up
        shade(hits.gbuffer, colour, Illumination([light], arrived, [visibility], ambient), up, self.threads)
        lap("shade")
        return Result({**seconds, "total": sum(seconds.values())}, visibility)

    def close(self) -> None:
        self.scene.close()


def moments(view: Moving, count: int) -> list[float]:
    """Times of `count` film frames, evenly spaced over the animation."""
    last = int(view.scene.duration * FPS)
    return [k / FPS for k in np.unique(np.linspace(0, last, count).round().astype(int)).tolist()]


def best_modes(device, view: Moving, threads: int, options) -> list[FrameMode]:
    """The two fastest combinations of build and tracing mode."""
    moment, width = moments(view, 3)[1], device.width
    eyes = [Primary(n, c) for n in (1, width) for c in (False, True)]
    lamps = [Shadow(n, o, c) for n in (1, width) for o in ORDERS[n == 1 :] for c in (False, True)]

    def timed_modes(build, hows) -> list[tuple[dict[str, float], FrameMode]]:
        peer, timing = (
            EmbreeFrames(FrameMode(build, *hows[0]), device, view, threads, options.spp, CLOCKS[options.clock]),
            [],
        )
        for how in hows:
            peer.mode = FrameMode(build, *how)
            progress(f"{view.name}: trying {peer.mode}")
            peer.frame(moment)  # compiles, and warms the caches
            timing.append((min((peer.frame(moment).seconds for _ in range(2)), key=lambda s: s["total"]), peer.mode))
        peer.close()
        return timing

    first = timed_modes(BUILDS[2], [(eyes[i % len(eyes)], lamp) for i, lamp in enumerate(lamps)])
    eye = min(first, key=lambda timing: timing[0]["gbuffer"])[1].primary
    best = [mode.shadow for _, mode in sorted(first, key=lambda timing: timing[0]["trace"])[:2]]
    timing = [pair for build in BUILDS for pair in timed_modes(build, [(eye, lamp) for lamp in best])]
    return [mode for _, mode in sorted(timing, key=lambda timing: timing[0]["total"])[:2]]


def measure(view: Moving, options) -> list[dict]:
    """Rows for all thread counts."""
    rows = []
    for threads in options.threads:
        rows += _measure(_device(threads, options.isa), view, threads, options)
    return rows


@cache
def _device(threads: int, isa: str | None):
    """Embree's device, or None without Embree. All scenes share it, because a closed device's threads stay busy."""
    return embree.Device(threads, isa) if has_embree() else None


def _measure(device, view: Moving, threads: int, options) -> list[dict]:
    clock, times = CLOCKS[options.clock], moments(view, options.frames)
    modes = best_modes(device, view, threads, options) if device else []
    contenders: list = [Ours(plan, view, threads, options.spp, clock) for plan in options.plans]
    contenders += [EmbreeFrames(mode, device, view, threads, options.spp, clock) for mode in modes]
    frames = {c.name: [] for c in contenders}
    differs = dict.fromkeys(frames, 0)
    for turn in range(-1, options.rounds):  # the first round is a warm-up and compares answers
        for i, moment in enumerate(times):
            progress(f"round {turn + 1} of {options.rounds}, frame {i + 1} of {len(times)}")
            reference = None
            for contender in contenders:
                seconds, visibility = contender.frame(moment)
                reference = visibility if reference is None else reference
                if turn < 0:
                    differs[contender.name] += int(np.count_nonzero(visibility != reference))
                else:
                    frames[contender.name].append(seconds)
    progress("")
    case = {"scene": view.name, "triangles": view.scene.n_triangles, "threads": threads, "clock": options.clock}
    case |= {"spp": options.spp, "frames": len(times), "rounds": options.rounds, "size": list(options.size)}
    rows = [_row(case, c, frames[c.name], differs[c.name]) for c in contenders]
    fastest = max((row["fps"] for row in rows if row["family"] == EMBREE), default=None)
    for row in rows:
        if fastest and row["family"] == OURS:
            row["ratio"] = row["fps"] / fastest
    print(f"\n{view.name}, {view.scene.n_triangles} triangles, {len(times)} frames, {threads} thread(s)\n{HEAD}")
    print("\n".join(_line(row) for row in rows), flush=True)
    for contender in contenders:
        contender.close()
    return rows


def _row(case: dict, contender, frames: list[dict], differs: int) -> dict:
    phases = {p: statistics.median(f[p] for f in frames) for p in PHASES}
    totals = [f["total"] for f in frames]
    row = {**case, "family": contender.family, "contender": contender.name, "fps": 1.0 / statistics.median(totals)}
    return {**row, "phases": phases, "totals": totals, "differs": differs}


_SHOWN = ("evaluate", "gbuffer", "cull", "build", "trace", "filter", "shade")
HEAD = f"{'contender':62s} {'fps':>6s} {'ratio':>6s} {'differs':>8s}  " + " ".join(f"{p:>8s}" for p in _SHOWN) + "  ms"


def _line(row: dict) -> str:
    ratio = f"{row['ratio']:.2f}" if "ratio" in row else ""
    phases = " ".join(f"{1e3 * row['phases'][p]:8.1f}" for p in _SHOWN)
    return f"{row['contender']:62s} {row['fps']:6.2f} {ratio:>6s} {row['differs']:8d}  {phases}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plans", nargs="+", default=[DEFAULT_PLAN])
    parser.add_argument(
        "--frames", type=int, default=8, help="frames of a 24 fps film, evenly spaced over the animation"
    )
    parser.add_argument("--spp", type=int, default=16)
    options = options_of(parser, MOVING)
    compare(options, measure, moving_views)


if __name__ == "__main__":
    start(main)
