"""The commands of studies. Each is a class that declares its arguments and its own steps; this module does the rest.

`StudyCommand.run` checks the arguments and outputs, opens the scene, runs the study with its progress or hands it to
shards and nodes, writes the results and reports them.
"""

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeAlias, TypeVar

from ..base import wings
from ..base.errors import InputError
from ..base.files import checked_folder
from ..base.option_fields import field_values
from ..base.wording import counted
from ..work.estimates import telling
from ..work.executors import LocalExecutor, traced_share
from ..work.joint_work import both_results
from ..work.result_summary import Summary, duration, speed_text
from . import console
from .console import ProgressDisplay
from .options import Json, Quiet, SceneArgument, literal, outputs_of, takes
from .scene_arguments import SceneArguments, SceneSpec, open_change, open_scene
from .shards import executor_for, for_node, report_shard
from .vegetation_options import VegetationSpec, add_vegetation, below_plants, parse_vegetation, sensors_below_plants

if TYPE_CHECKING:
    from .. import SceneChange, Sensors
    from ..engine.scene import AnyScene
    from ..work.executors import Executor

_Options = TypeVar("_Options")
_Result = TypeVar("_Result")
_T = TypeVar("_T")

Writers: TypeAlias = Mapping[str, Callable[..., object]]
"""Name of a field that names files -> what writes one of them, in the order of writing; of "map", with its `sheet`."""

# --- Runs -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scenes:
    """The scene of a study, without and with its vegetation, whose faces follow all others.

    For a study before and after a change, the bare scene is what both states share, on which sensors lie.
    """

    bare: "AnyScene"
    planted: "AnyScene"
    change: "SceneChange | None" = None  # of the scene, by --add and --remove
    earlier: "AnyScene | None" = None  # the scene before the change, with vegetation; None: it is not studied

    @property
    def before(self) -> "Scenes":
        """The scenes before the change."""
        assert self.earlier is not None
        return replace(self, planted=self.earlier)

    @property
    def n_faces(self) -> int:
        """The number of faces in the file of the scene."""
        return self.bare.n_triangles if self.change is None else self.change.n_faces

    def sensors(self, text: str, threads: int | None, areas: Any = None) -> "Sensors":
        """The sensors that a text names on the scene without vegetation, for the scene with it."""
        sensors = sensors_below_plants(text, self.bare, self.planted, threads, areas)
        if self.earlier is None or self.change is None:
            return sensors
        return self.change.exposed(sensors, threads)

    def sensor_blocks(self, text: str, threads: int | None, areas: Any = None) -> Any:
        """As `sensors`, but `DescribedSensors` if they can be made by block."""
        if areas is not None or self.earlier is not None:
            return self.sensors(text, threads, areas)
        return below_plants(wings.named(wings.SENSOR_BLOCKS)(text, self.bare, threads), self.bare, self.planted)


class StudyRun(ProgressDisplay):
    """A study's run, with its progress: its time, and the files that it wrote.

    args : arguments of the command, with the fields `json` and `quiet`
    """

    def __init__(self, args: Any):
        super().__init__(args.quiet)
        self._args = args
        self.seconds, self.traced = 0.0, 1.0  # of the study, and the share of its rays that were traced now
        self.written = list[str]()

    def open(self, spec: SceneSpec, trees: VegetationSpec | None = None, before: bool = False) -> Scenes:
        """The scene without and with its trees, as `opened` makes it."""
        self.say("reading the scene")
        scenes = opened(spec, trees, self._args.quiet, before)
        self.say("preparing")
        return scenes

    def timed(self, work: Callable[[], _T]) -> _T:
        """What `work` returns; its time is that of the study."""
        start = perf_counter()
        with telling(lambda line: None if self._args.quiet else console.say(f"note: {line}")):
            result = work()
        self.seconds = perf_counter() - start
        return result

    def save(self, write: Callable[[Path], object], paths: Iterable[Path]) -> None:
        """Write files."""
        self.say("writing the results")
        for path in paths:
            write(path)
            self.written.append(str(path))

    def rows(self, rays: int | None = None) -> list[tuple[str, str]]:
        """The last fields of a report: the time, with the speed if the number of `rays` is known, and the files.

        Instead of the speed of few rays, it states their number.
        """
        traced = 0 if rays is None else round(self.traced * rays)
        speed = speed_text(traced, self.seconds) or (f", {counted(traced, 'ray')}" if traced else "")
        return [("time", duration(self.seconds) + speed), *(("written", path) for path in self.written)]

    def report(self, summary: Summary, files: str | None = "outputs") -> int:
        """Print a summary, with the time and the files, as JSON or as text; return the exit code.

        files : the name of the files in JSON; None: the summary has the time and the files
        """
        if self._args.json:
            console.print_json(summary.values | ({} if files is None else {files: self.written}) | dict(summary.parts))
        elif not self._args.quiet:
            lines = [*summary.lines, *([] if files is None else self.rows(summary.rays))]
            table = summary.table
            if table is not None and table.leads:
                console.print_table(table.headers, table.rows, table.right)
            console.print_fields(lines)
            if table is not None and not table.leads:
                console.print_table(table.headers, table.rows, table.right)
        return 0


def opened(spec: SceneSpec, trees: VegetationSpec | None, quiet: bool, before: bool = False) -> Scenes:
    """The scene without and with its trees; `before`: also before its change."""
    if spec.added or spec.removed:
        change = open_change(spec, quiet)
        if not before:
            return Scenes(change.after, add_vegetation(change.after, trees), change)
        shared = change.shared()
        planted = add_vegetation(shared, trees)  # trees stand on what both states share
        return Scenes(shared, change.state(planted, "after"), change, change.state(planted, "before"))
    bare = open_scene(spec, quiet)
    return Scenes(bare, add_vegetation(bare, trees))


# --- Commands ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class StudyCommand(SceneArguments, Generic[_Options, _Result]):
    """The command of a study. A subclass has a field for each argument, and its docstring is the help.

    Its fields `output` and `map` name files; `trees`, `shard`, `ray` and `merge` are known here, too.
    """

    options: _Options  # the study's own, made from the derived options of the command
    scene: SceneArgument
    json: Json = False
    quiet: Quiet = False

    records_trees: ClassVar[bool] = False  # whether the result has a record, which names the trees
    of_one_state: ClassVar[tuple[str, ...]] = ()  # fields of files that the study writes itself, of the state after
    files: ClassVar[str | None] = "outputs"  # name of the written files in JSON; None: the summary names them

    # What is a study's own:

    def check(self) -> None:
        """Raise an InputError for what can be refused before the scene is read."""

    def check_output(self, path: Path) -> None:
        """Raise an InputError if this file of `output` cannot hold the result."""

    def check_sheet(self, sheet: Any, scenes: Scenes) -> None:
        """Raise an InputError, before the work, if the map is known not to fit on its sheet."""

    def default_output(self) -> str | None:
        """The name of the file that is written if neither `output` nor `map` names one."""
        return None

    def work(self, scenes: Scenes, executor: "Executor | None") -> Callable[[], _Result | None]:
        """The prepared call of the study's function, with its input.

        executor : runs the units of a study that has them; its function returns None if it leaves some to others
        """
        raise NotImplementedError

    def compared(self, before: _Result, after: _Result, scenes: Scenes) -> _Result:
        """The results of both states as one, for commands with the field `before`."""
        raise NotImplementedError

    def about_of(self, result: _Result) -> dict[str, Any] | None:
        """The metadata of the result; None if it has none."""
        about: dict[str, Any] | None = getattr(result, "about", None)
        return about

    def describe(self, result: _Result, scenes: Scenes) -> None:
        """Add the vegetation and the change, which only the command has, to the record of the result if it has one."""
        about = self.about_of(result)
        if scenes.change is not None and about is not None:
            about["change"] = list(scenes.change.notes)
        if self.records_trees and getattr(self, "trees", None) is not None and about is not None:
            about["trees"] = getattr(self, "trees")  # noqa: B009 - a field of subclasses

    def writers(self, result: _Result, scenes: Scenes) -> Writers:
        """What writes the files of each field that names some."""
        writers: Any = result
        return {"output": writers.save, **({"map": writers.save_map} if hasattr(self, "map") else {})}

    def summary(self, result: _Result, scenes: Scenes, seconds: float) -> Summary:
        """The summary of the result; `seconds`: of the study."""
        raise NotImplementedError

    def close(self, result: _Result) -> None:
        """Remove what the result was made from, after its files have been written."""

    # What all have:

    @property
    def spec(self) -> SceneSpec:
        """The scene."""
        return self.spec_of(self.scene)

    @property
    def in_both_states(self) -> bool:
        """Whether the state before the change of the scene is studied, too."""
        return bool(getattr(self, "before", False))

    @property
    def tree_spec(self) -> VegetationSpec | None:
        """The trees."""
        return parse_vegetation(getattr(self, "trees", None))

    @property
    def threads(self) -> int | None:
        """The number of threads; None: all cores."""
        threads: int | None = getattr(self.options, "threads", None)
        return threads

    def work_of_states(self, scenes: Scenes, executor: "Executor | None") -> Callable[[], _Result | None]:
        """`work`; with --before, that of both states, whose units are those of one work."""
        if scenes.earlier is None:
            return self.work(scenes, executor)
        nothing: dict[str, Any] = dict.fromkeys(self.of_one_state)
        first = replace(self, **nothing)

        def study() -> _Result | None:
            pair = both_results(
                lambda each: first.work(scenes.before, each)(), lambda each: self.work(scenes, each)(), executor
            )
            return None if pair is None else self.compared(*pair, scenes)

        return study

    def paths(self, name: str) -> list[Path]:
        """The files that a field names, or by default."""
        given = getattr(self, name, None)
        if not given and name == "output" and not getattr(self, "map", None):
            given = self.default_output()
        return [] if not given else [Path(each) for each in (given if isinstance(given, list) else [given])]

    def run(self) -> int:
        """Run the command and return its exit code."""
        spec, trees = self.spec, self.tree_spec
        if self.in_both_states and not (spec.added or spec.removed):
            raise InputError("--before compares the scene with its change; give --add FILE or --remove ID, too")
        self.check()
        sheet = self._sheet()
        for path in self.paths("output"):
            self.check_output(path)
        executor = self._executor()
        with StudyRun(self) as run:
            scenes = run.open(spec, trees, self.in_both_states)
            if sheet is not None:
                self.check_sheet(sheet, scenes)
            if any(path.suffix.lower() == ".html" for name in ("output", "page") for path in self.paths(name)):
                wings.named(wings.CHECK_PAGE)(scenes.planted)
            result = run.timed(self.work_of_states(scenes, executor))
            if result is None:
                return report_shard(executor, self, run.seconds)
            run.traced = traced_share(executor)
            self.describe(result, scenes)
            for name, write in self.writers(result, scenes).items():
                run.save(partial(write, sheet=sheet) if name == "map" else write, self.paths(name))
        code = self.report(run, result, scenes)
        self.close(result)
        return code

    def report(self, run: StudyRun, result: _Result, scenes: Scenes) -> int:
        """Print the summary of the result, unless there is nothing to print, and return the exit code."""
        if self.quiet and not self.json:
            return 0
        summary, up = self.summary(result, scenes, run.seconds), scenes.bare.up
        named = summary._replace(values=summary.values | {"up": up}, lines=[*summary.lines, ("up", f"{up} axis")])
        return run.report(named, self.files)

    def _sheet(self) -> Any:
        """The options of the map sheet, checked, with the input files as its sources; None: there is no map."""
        if not hasattr(self, "map"):  # the sheet of a data set is another one
            return None
        texts, maps = getattr(self, "sheet", None), self.paths("map")
        if texts and not maps:
            raise InputError("--sheet is for map sheets; give --map FILE, too")
        if not maps:
            return None
        for path in maps:
            wings.named(wings.CHECK_MAP)(path)
        sheet = wings.named(wings.PARSE_SHEET)(texts or [])
        return replace(sheet, sources=tuple(dict.fromkeys((*self._input_files(), *sheet.sources))))

    def _input_files(self) -> list[Path]:
        """The files that the arguments name, apart from outputs."""
        from ..cluster.node_files import INPUTS, files_in

        given = vars(self) | field_values(self.options)
        left_out = {*outputs_of(type(self)), "merge"}
        names = [
            name for name in given if name not in left_out and (name in (*INPUTS, "add") or _has_path(given[name]))
        ]
        scene = [] if self.spec.path is None else [self.spec.path]
        return list({path.resolve(): path for path in (*scene, *files_in(given, names).values())}.values())

    def _executor(self) -> "Executor | None":
        """The executor that --shard, --ray or --merge names, or one that resumes; parts lie beside the first output."""
        if not hasattr(self, "shard"):
            return None
        first = next((path for name in outputs_of(type(self)) for path in self.paths(name)), None)
        if first is None:
            for name in ("shard", "ray"):
                if (value := getattr(self, name)) is not None:
                    why = "keeps parts beside an output, and there is none; give --output FILE"
                    raise InputError(f"--{name} {value}: {why}")
            return None
        inputs = vars(self) | field_values(self.options)
        plan = getattr(self.options, "plan", None)
        executor = executor_for(self, first, partial(start_on_node, self), inputs, plan)
        return executor or LocalExecutor(checked_folder(first.with_suffix(".parts"), parents=True))

    def on_node(self, paths: dict[str, str], threads: int) -> Self:
        """The command for a node of a cluster.

        paths : names of arguments -> paths of their files there; results go to the current folder
        threads : of the node
        """
        from ..cluster.node_files import with_files

        given: Any = self.options
        of_node = {"threads": self.threads or threads} | with_files(field_values(given), paths)
        return replace(for_node(self, paths), quiet=True, options=replace(given, **of_node))


def _has_path(value: object) -> bool:
    """Whether a value is a path, or a list with one."""
    return any(isinstance(each, Path) for each in (value if isinstance(value, list) else [value]))


def start_on_node(command: StudyCommand[Any, Any], paths: dict[str, str], threads: int, executor: "Executor") -> None:
    """Start a study on a node of a cluster: its units go to the executor. As `cluster.ray_workers.Prepare`."""
    there = command.on_node(paths, threads)
    scenes = opened(there.spec, there.tree_spec, True, there.in_both_states)
    there.work_of_states(scenes, executor)()


def command_of(
    study: type[StudyCommand[Any, Any]], options: type, parse: Mapping[str, Callable[[Any], Any]] | None = None
) -> Callable[..., int]:
    """The command for Typer.

    options : class of the study's options, from which further ones of the command are derived
    parse : name of an option that is not yet the value of its field -> what makes it
    """
    parsed = parse or {}

    def read(given: dict[str, Any]) -> Any:
        return options(**literal(given, options), **{name: make(given[name]) for name, make in parsed.items()})

    def run(command: StudyCommand[Any, Any]) -> int:
        return command.run()

    run.__doc__ = None if sys.flags.optimize >= 2 else study.__doc__  # -OO: dataclasses make up others
    return takes(study, options, read)(run)
