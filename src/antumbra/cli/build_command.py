"""``antumbra build``: build a store from scenes, in units that run in threads, shards or on a cluster, and resume."""

import hashlib
import json
import platform
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, cast

import typer

from ..base.errors import InputError
from ..base.files import checked_folder
from ..base.memory import readable_size
from ..formats.array_files import FILES
from ..formats.format_registry import PLY, STL, format_of
from ..work.result_summary import duration
from . import arguments, console
from .console import ProgressDisplay
from .options import SCENE_HELP, Json, Quiet, Threads, UpOption, takes, writes
from .scene_arguments import SceneArguments, SceneSpec, is_footprints, is_raster, open_for_store, stream_rasters
from .shards import MergeOption, RayOption, ShardOption, executor_for, for_node, report_shard

if TYPE_CHECKING:
    from ..cluster.ray_executor import Cluster
    from ..generate.generated_scene import StreamedCity
    from ..scene.scene_data import SceneData
    from ..store.read_units import ReadUnit, StreamedScene
    from ..store.store_build import BuildReport
    from ..work.executors import StagedExecutor, UnitCollector
    from ..work.staged_parts import PartStages, SharedFolder


@dataclass(frozen=True)
class BuildArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scenes: Annotated[list[str], typer.Argument(help=SCENE_HELP, metavar="SCENE...")]
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="The store to write: *.antumbra, or *.tiles, a list of several.",
            metavar="FILE",
            callback=writes(".antumbra", ".tiles"),
        ),
    ]
    tile: Annotated[
        str | None, typer.Option(help="Triangles of a tile of *.tiles: 100M.  [default: 134M]", metavar="N")
    ] = None
    max_memory: Annotated[
        str, typer.Option(help="Memory limit of the build, in bytes or with a suffix: 512M, 4G.", metavar="SIZE")
    ] = "4G"
    up: UpOption = None
    threads: Threads = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None
    json: Json = False
    quiet: Quiet = False


@takes(BuildArguments)
def build(args: BuildArguments) -> int:
    """Build a store for scenes larger than memory.

    A store holds the triangles in chunks, each with its BVH and checksums. Several scenes are merged in the given
    order, in their state at time 0, with all their cameras and lights. procedural:city is generated and written block
    by block, at any size. glTF, OBJ and CityJSONSeq files, binary PLY and STL files of triangles and rasters of heights
    are read piece by piece; other scenes, one at a time, into memory. Rasters that follow one another, and those of a
    folder, are tiles of one surface. A store holds up to 2^31 - 1 triangles, a list of tiles any number. The same
    scenes give the same bytes for any --max-memory and --threads. An interrupted build resumes.

    \b
    Examples
      antumbra build sponza.glb -o sponza.antumbra
      antumbra build "procedural:city?triangles=350M" -o city.antumbra --max-memory 4G
      antumbra build dem.tif -o dem.antumbra --max-memory 4G
      antumbra build west.tif east.tif -o dem.antumbra
      antumbra build country.tif -o country.tiles --tile 100M
      antumbra info city.antumbra --check
    """
    args.refuse_changes("stores hold whole files; name all of them as SCENEs")
    memory = arguments.parse_bytes(args.max_memory, "--max-memory")
    scenes = [SceneFiles(specs, args.threads, args.quiet) for specs in _groups(args)]

    from ..store.system_resources import peak_resident_memory

    start = perf_counter()
    with ProgressDisplay(args.quiet) as display, ExitStack() as kept:
        display.say("reading")
        stages = _stages(args, scenes, kept)
        report = _build(args, scenes, stages, display)
    if report is None:
        assert stages is not None
        return report_shard(stages.executor, args, perf_counter() - start)
    peak = peak_resident_memory()
    if args.json:
        console.print_json({**report._asdict(), "path": str(report.path), "max_memory": memory, "peak_resident": peak})
    elif not args.quiet:
        console.print_fields(_build_fields(report, peak))
    return 0


def _build(
    args: BuildArguments, scenes: "list[SceneFiles]", stages: "PartStages | None", display: ProgressDisplay
) -> "BuildReport | None":
    from ..engine.store_building import build_units

    units = [unit for each in scenes for unit in each.units()]
    memory = arguments.parse_bytes(args.max_memory, "--max-memory")
    return build_units(units, args.output, memory, args.threads, progress=display.say, stages=stages, tile=_tile(args))


def _tile(args: BuildArguments) -> int | None:
    return None if args.tile is None else arguments.parse_count(args.tile, "--tile")


# --- Scenes -----------------------------------------------------------------------------------------------------------


_SIDE_FILES = ".prj", ".aux.xml", ".tfw", ".wld", ".ovr", ".msk", ".dbf", ".shx", ".cpg"
"""Suffixes of files that belong to a raster or to footprints, after its name or instead of its suffix."""


class SceneFiles:
    """A scene of a build, or rasters that are tiles of one surface. It is opened when it is read."""

    def __init__(self, specs: Sequence[SceneSpec], threads: int | None, quiet: bool):
        self._specs, self._threads, self._quiet = list(specs), threads, quiet
        self._opened: SceneData | StreamedScene | None = None  # of several units

    @property
    def name(self) -> str:
        """The name of the (first) scene, for errors."""
        return str(self._specs[0].path or self._specs[0].name)

    def units(self) -> "list[ReadUnit]":
        """What reads it: a unit for each span of a scene that has some."""
        from ..store.read_units import ReadUnit

        n = self._n_spans()
        return [ReadUnit(self._open, None if n == 1 else k) for k in range(n)]

    def content(self) -> str | None:
        """A text that changes with the scene; None if it refers to other files that are not known."""
        from ..formats.referred_files import referred_files

        texts = list[str]()
        for spec in self._specs:
            files = [path for path in (spec.path, *spec.terrain) if path is not None]
            referred = [referred_files(path) for path in files]
            if None in referred:
                return None
            others = [each for each in referred if each is not None]
            sums = [_sum(each) for path, more in zip(files, others) for each in (*_with_side_files(path), *more)]
            name = spec.name if spec.path is None else spec.path.name
            texts.append(repr((spec._replace(path=None, terrain=(), name=name), sums)))
        return json.dumps(texts)

    def _n_spans(self) -> int:
        spec = self._specs[0]
        if self._is_city(spec):
            return self._city(spec).n_spans
        if spec.path is None or spec.transmittance or format_of(spec.path) not in (PLY, STL):
            return 1
        from ..formats.mesh_files import spans_of_mesh_file

        with suppress(OSError):  # as its reader will say
            return spans_of_mesh_file(spec.path)
        return 1

    def _open(self) -> "Iterator[SceneData | StreamedScene]":
        spec = self._specs[0]
        if spec.is_streamed:
            yield stream_rasters(self._specs)
        elif self._n_spans() == 1:
            yield self._scene_of(spec)
        else:
            self._opened = self._opened or self._scene_of(spec)
            yield self._opened

    def _scene_of(self, spec: SceneSpec) -> "SceneData | StreamedCity":
        return self._city(spec) if self._is_city(spec) else open_for_store(spec, self._quiet)

    def _is_city(self, spec: SceneSpec) -> bool:
        return spec.path is None and spec.name == "city" and spec.up is None

    def _city(self, spec: SceneSpec) -> "StreamedCity":
        from ..generate.generated_scene import StreamedCity
        from ..kernels.parallel import thread_count

        return StreamedCity(spec.triangles, spec.seed, thread_count(self._threads))


def _groups(args: BuildArguments) -> list[list[SceneSpec]]:
    """The scenes; rasters that follow one another, which are read piece by piece, are one."""
    specs = [spec for text in args.scenes for spec in _tiles_of(args.spec_of(text))]
    groups = list[list[SceneSpec]]()
    for is_streamed, group in groupby(specs, lambda spec: spec.is_streamed):
        listed = list(group)
        groups += [listed] if is_streamed else [[spec] for spec in listed]
    return groups


def _tiles_of(spec: SceneSpec) -> list[SceneSpec]:
    """The scene, or the rasters of heights in a folder, by name; a folder of vertex frames is a scene."""
    if spec.path is None or not spec.path.is_dir() or any((spec.path / name).exists() for name in FILES):
        return [spec]
    return [spec._replace(path=path) for path in sorted(spec.path.iterdir()) if is_raster(path)] or [spec]


def _with_side_files(path: Path) -> list[Path]:
    """A file, and those that are read with it."""
    if not (is_raster(path) or is_footprints(path)):
        return [path]
    beside = (each for suffix in _SIDE_FILES for each in (path.with_suffix(suffix), Path(f"{path}{suffix}")))
    return [path, *(each for each in beside if each.is_file())]


def _sum(path: Path) -> str:
    """The SHA-256 of a file; empty if it cannot be read, as its reader will say."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""


# --- Stages -----------------------------------------------------------------------------------------------------------


def _stages(args: BuildArguments, scenes: "list[SceneFiles]", kept: ExitStack) -> "PartStages | None":
    """The stages of the executor that --shard, --ray or --merge names, or of one that resumes.

    kept : ends workers of a cluster

    None: a build that cannot resume, because a changed scene would not be recognised.
    """
    from ..store.store_format import TILES_SUFFIX
    from ..work.executors import LocalExecutor
    from ..work.staged_parts import PartStages, SharedFolder
    from ..work.work_parts import about_parts
    from .shards import shards_folder

    contents = [each.content() for each in scenes]
    if None in contents:
        for option, value in (("--shard", args.shard), ("--ray", args.ray)):
            if value is not None:
                name = scenes[contents.index(None)].name
                why = "has files that are not known" if not Path(name).is_dir() else "is a folder"
                raise InputError(f"{option} {value}: {name} {why}; use a single file, such as .glb or .tif")
        return None
    if args.output.suffix.lower() == TILES_SUFFIX:
        contents.append(f"tiles {_tile(args)}")
    about = about_parts("store", _digest(contents))
    shared = SharedFolder.at(shards_folder(args.output))
    start = partial(start_on_node, args, about, shared)
    executor = executor_for(args, args.output, start, vars(args), None)
    if executor is None:
        executor = LocalExecutor(checked_folder(args.output.with_suffix(".parts"), parents=True))
    is_alone, on_cluster = args.shard is None and not args.merge, args.ray is not None and not args.merge
    if on_cluster:
        kept.callback(cast("Cluster", executor).close)
    return PartStages(cast("StagedExecutor", executor), about, shared if on_cluster else None, is_alone)


def start_on_node(
    args: BuildArguments,
    about: dict[str, str],
    shared: "SharedFolder",
    paths: dict[str, str],
    threads: int,
    executor: "UnitCollector",
) -> None:
    """Start a build on a node of a cluster: its units go to the executor. As `cluster.ray_workers.Prepare`."""
    from ..cluster.node_files import refers_to_files
    from ..work.staged_parts import PartStages

    shared.check()
    there = replace(for_node(args, paths), threads=args.threads or threads, quiet=True)
    groups = _groups(there)
    scenes = [SceneFiles(specs, there.threads, True) for specs in groups]
    referring = [spec.path for specs in groups for spec in specs if spec.path and refers_to_files(spec.path)]
    if referring and _digest([each.content() for each in scenes]) != about["scene"]:
        name = referring[0].name
        raise InputError(f"{name}: refers to files that node {platform.node()} has otherwise; share their folder")
    _build(there, scenes, PartStages(executor, about, shared, is_alone=False), ProgressDisplay(True))


def _digest(contents: list[str | None]) -> str:
    return hashlib.sha256(json.dumps(contents).encode()).hexdigest()


def _build_fields(report: "BuildReport", peak: int | None) -> Iterator[tuple[str, str]]:
    phases = dict(report.seconds)
    total = phases.pop("total")
    yield "store", str(report.path)
    yield "triangles", f"{report.triangles:,} in {report.chunks:,} chunk{'s' * (report.chunks != 1)}"
    yield "size", f"{readable_size(report.bytes)}, {report.bytes / report.triangles:.1f} bytes per triangle"
    yield "time", f"{duration(total)}: " + ", ".join(f"{k} {duration(s)}" for k, s in phases.items())
    if peak is not None:
        yield "memory", f"{readable_size(peak)} at the peak"
