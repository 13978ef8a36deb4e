"""The steps that the commands of all studies share: open the scene, run, write the results, report."""

from collections.abc import Callable, Iterable
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from . import console
from .console import ProgressDisplay
from .scene_arguments import SceneSpec, in_memory, open_scene
from .vegetation_options import VegetationSpec, add_vegetation

if TYPE_CHECKING:
    from ..engine.scene import AnyScene

_P = ParamSpec("_P")
_T = TypeVar("_T")


class StudyRun(ProgressDisplay):
    """A study's run, with its progress: its time, and the files that it wrote.

    args : arguments of the command, with the fields `json` and `quiet`
    """

    def __init__(self, args: Any):
        super().__init__(args.quiet)
        self._args = args
        self.seconds = 0.0
        self.written = list[str]()

    def open(
        self, spec: SceneSpec, trees: VegetationSpec | None = None, to_memory: bool = False
    ) -> "tuple[AnyScene, AnyScene]":
        """The scene without and with its trees. `to_memory`: refuse one in a store."""
        self.say("reading the scene")
        bare = open_scene(spec, self._args.quiet)
        if to_memory:
            bare = in_memory(bare)
        scene = add_vegetation(bare, trees)
        self.say("preparing")
        return bare, scene

    def timed(self, work: Callable[_P, _T], *args: _P.args, **keywords: _P.kwargs) -> _T:
        """What `work` returns; its time is that of the study."""
        start = perf_counter()
        result = work(*args, **keywords)
        self.seconds = perf_counter() - start
        return result

    def save(self, write: Callable[[Path], object], paths: Iterable[Path] | None) -> None:
        """Write files."""
        self.say("writing the results")
        for path in paths or ():
            write(path)
            self.written.append(str(path))

    def rows(self, rays: int | None = None) -> list[tuple[str, str]]:
        """The last fields of a report: the time, with the speed if the number of `rays` is known, and the files."""
        speed = "" if rays is None else f", {rays / 1e6 / max(self.seconds, 1e-9):,.1f} Mrays/s"
        return [("time", console.duration(self.seconds) + speed), *(("written", path) for path in self.written)]

    def report(self, answer: dict[str, Any], rows: Iterable[tuple[str, str]]) -> int:
        """Print the answer as JSON, or the fields as text; return the exit code."""
        if self._args.json:
            console.print_json(answer)
        elif not self._args.quiet:
            console.print_fields(rows)
        return 0
