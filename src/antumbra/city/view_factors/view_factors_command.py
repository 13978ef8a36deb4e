"""``antumbra view-factors``: view factors between surfaces, as a sparse matrix or a list."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...base.checks import alternatives
from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli.options import LISTED_LAST, CrsOption, ListedBefore, SceneArgument, UpOption, writes
from ...cli.scene_arguments import DEFAULT_SCENE, BeforeOption
from ...cli.shards import MergeOption, RayOption, ShardOption
from ...cli.study_run import Scenes, StudyCommand, Writers, command_of
from ...work.result_summary import Summary
from .view_factor_options import ViewFactorOptions

if TYPE_CHECKING:
    from ...work.executors import Executor
    from .view_factor_matrix import ViewFactors

_SUFFIXES = ".npz", ".csv"  # as in `city.view_factors.view_factor_matrix`, which is slow to import


@dataclass(frozen=True, kw_only=True)
class ViewFactorsCommand(StudyCommand[ViewFactorOptions, "list[tuple[ViewFactors, float]]"]):
    """Compute view factors between surfaces and the sky.

    F_ij is the fraction of the diffuse radiation leaving surface i that arrives at surface j. Each row also has the
    fractions that arrive at the sky, at the ground below the horizon, and at the backs of surfaces. It sums to 1.

    \b
    Outputs
      .npz    sparse matrix for scipy.sparse.load_npz, with errors, areas and names
      .csv    a row per pair of surfaces: from, to, factor, error, area

    \b
    Examples
      antumbra view-factors room.obj --side back --samples 65536 -o factors.csv
      antumbra view-factors city.city.json --per building -o factors.npz
      antumbra view-factors car.glb --per object --reciprocal -o factors.npz -o factors.csv
    """

    scene: SceneArgument = DEFAULT_SCENE
    reciprocal: Annotated[
        bool,
        typer.Option("--reciprocal", help="Make the factors reciprocal. A_i F_ij = A_j F_ji then holds exactly."),
        ListedBefore("seed"),
    ] = False
    before: BeforeOption = False
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            help=f"Output file; may be repeated: {alternatives(_SUFFIXES)}.",
            show_default=False,
            callback=writes(*_SUFFIXES),
        ),
        ListedBefore("time"),
    ] = None
    up: Annotated[UpOption, ListedBefore("threads")] = None
    crs: CrsOption = None
    shard: Annotated[ShardOption, LISTED_LAST] = None
    ray: RayOption = None
    merge: MergeOption = None

    def check(self) -> None:
        for path in self.paths("output"):
            if self.before and path.suffix.lower() != _SUFFIXES[1]:
                raise InputError(f"{path.name}: both states, as by --before, are written as {_SUFFIXES[1]}")
        if not self.output and not self.json and self.quiet:
            raise InputError("there is nothing to write: give --output, --json, or leave --quiet out")

    def work(
        self, scenes: Scenes, executor: "Executor | None"
    ) -> "Callable[[], list[tuple[ViewFactors, float]] | None]":
        from .view_factors import view_factors

        def study() -> "list[tuple[ViewFactors, float]] | None":
            sampled: ViewFactors | None = view_factors(scenes.planted, keep=executor, **field_values(self.options))
            if sampled is None:  # a shard
                return None
            return [(sampled.reciprocal() if self.reciprocal else sampled, sampled.reciprocity_error)]

        return study

    def compared(
        self,
        before: "list[tuple[ViewFactors, float]]",
        after: "list[tuple[ViewFactors, float]]",
        scenes: Scenes,
    ) -> "list[tuple[ViewFactors, float]]":
        return [*before, *after]

    def writers(self, result: "list[tuple[ViewFactors, float]]", scenes: Scenes) -> Writers:
        (before, _), (factors, _) = result[0], result[-1]
        return {"output": factors.save if len(result) == 1 else partial(factors.save_change, before=before)}

    def summary(self, result: "list[tuple[ViewFactors, float]]", scenes: Scenes, seconds: float) -> Summary:
        factors, sampled_error = result[-1]
        return factors.summary(sampled_error, seconds)


view_factors = command_of(ViewFactorsCommand, ViewFactorOptions)
