"""``antumbra build``: writes scenes that are larger than memory to a store."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import arguments, report
from .arguments import SceneSpec
from .options import SCENE_HELP, Json, Quiet, Threads, UpOption
from .outputs import writes
from .progress import ProgressDisplay
from .sceneinput import open_scene

if TYPE_CHECKING:
    from ..store.store_build import BuildReport


def build(
    scenes: Annotated[list[str], typer.Argument(help=SCENE_HELP, metavar="SCENE...")],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="The store to write: *.antumbra.", metavar="FILE", callback=writes(".antumbra")
        ),
    ],
    max_memory: Annotated[
        str, typer.Option(help="Memory to build with, in bytes, or with M or G: 512M, 4G.", metavar="SIZE")
    ] = "4G",
    up: UpOption = None,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write SCENEs, as one scene, to a store that need not fit in memory.

    A store holds the triangles in chunks, each with its BVH and checksums. Several scenes are merged in the order
    given, as they are at time 0. The cameras and lights of all scenes are kept. procedural:city is made and written
    block by block, at any size. Other scenes are in memory, one at a time, while they are read. The same scenes give
    the same bytes, for any --max-memory and --threads.

    \b
    Examples
      antumbra build sponza.glb -o sponza.antumbra
      antumbra build "procedural:city?triangles=350M" -o city.antumbra --max-memory 4G
      antumbra info city.antumbra --check
    """
    specs = [arguments.parse_scene(text) for text in scenes]
    memory = arguments.parse_bytes(max_memory, "--max-memory")

    from ..engine.store_building import build_store
    from ..store.system_resources import peak_resident

    with ProgressDisplay(quiet) as display:
        display.say("reading")
        opened = _opened(specs, None if up is None else up.value, threads, quiet)
        made = build_store(opened, output, max_memory=memory, threads=threads, progress=display.say)
    peak = peak_resident()
    if json:
        report.print_json({**made._asdict(), "path": str(made.path), "max_memory": memory, "peak_resident": peak})
    elif not quiet:
        report.print_fields(_fields(made, peak))


def _opened(specs: list[SceneSpec], up: str | None, threads: int | None, quiet: bool) -> Iterator:
    """Yield the scenes one after the other. A city is yielded as pieces that are made later."""
    from ..generate.generated_scene import StreamedCity
    from ..kernels.parallel import thread_count

    for spec in specs:
        if spec.path is None and spec.name == "city" and up is None:
            yield StreamedCity(spec.triangles, spec.seed, thread_count(threads))
        else:
            yield open_scene(spec, up, quiet)


def _fields(made: "BuildReport", peak: int | None) -> Iterator[tuple[str, str]]:
    phases = dict(made.seconds)
    total = phases.pop("total")
    yield "store", str(made.path)
    yield "triangles", f"{made.triangles:,} in {made.chunks:,} chunk{'s' * (made.chunks != 1)}"
    yield "size", f"{report.size_in_memory(made.bytes)}, {made.bytes / made.triangles:.1f} bytes a triangle"
    yield "time", f"{report.duration(total)}: " + ", ".join(f"{k} {report.duration(s)}" for k, s in phases.items())
    if peak is not None:
        yield "memory", f"{report.size_in_memory(peak)} at the peak"
