"""``antumbra view-factors``: view factors between surfaces, as a sparse matrix or a list."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ...base.checks import alternatives
from ...base.errors import InputError
from ...cli import console
from ...cli.options import CrsOption, Json, Quiet, SceneArgument, Threads, TimeOption, UpOption, takes, writes
from ...cli.scene_arguments import DEFAULT_SCENE, SceneArguments
from ...cli.study_run import StudyRun

if TYPE_CHECKING:
    from ...engine.scene import AnyScene
    from .view_factor_matrix import ViewFactors

_SUFFIXES = ".npz", ".csv"  # as in `jobs.view_factors.view_factor_matrix`, which is slow to import
_MOST = 20  # most surfaces that are printed


@dataclass(frozen=True)
class ViewFactorsArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scene: SceneArgument = DEFAULT_SCENE
    surfaces: Annotated[
        Literal["face", "surface", "object", "building"],
        typer.Option(
            help="What a surface is; surface: a semantic surface of CityJSON, otherwise a planar part of an object."
        ),
    ] = "surface"
    samples: Annotated[
        int, typer.Option(help="Rays per surface, rounded up to a power of two.", min=64, max=1 << 22)
    ] = 4096
    side: Annotated[
        Literal["front", "back"], typer.Option(help="Side of the faces; back: for rooms whose faces point outwards.")
    ] = "front"
    reciprocal: Annotated[
        bool, typer.Option("--reciprocal", help="Adjust the factors, so that A_i F_ij = A_j F_ji holds exactly.")
    ] = False
    seed: Annotated[int, typer.Option(help="Of the sample points.", min=0)] = 0
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            help=f"Output file; may be repeated: {alternatives(_SUFFIXES)}.",
            show_default=False,
            callback=writes(*_SUFFIXES),
        ),
    ] = None
    time: TimeOption = 0.0
    up: UpOption = None
    crs: CrsOption = None
    threads: Threads = None
    json: Json = False
    quiet: Quiet = False


@takes(ViewFactorsArguments)
def view_factors(args: ViewFactorsArguments) -> int:
    """Find the view factors between the surfaces of SCENE, and of the sky.

    F_ij is the share of the diffuse radiation leaving surface i that arrives at surface j. Each row also has the shares
    of the sky, of the ground below the horizon, and of other faces: the backs of surfaces. Each row sums to 1.

    \b
    Outputs
      .npz    sparse matrix for scipy.sparse.load_npz, with errors, areas and names
      .csv    a row per pair of surfaces: from, to, factor, error, area

    \b
    Examples
      antumbra view-factors room.obj --side back --samples 65536 -o factors.csv
      antumbra view-factors city.city.json --surfaces building -o factors.npz
      antumbra view-factors car.glb --surfaces object --reciprocal -o factors.npz -o factors.csv
    """
    spec = args.spec_of(args.scene)
    outputs = args.output or []
    if not outputs and not args.json and args.quiet:
        raise InputError("there is nothing to write: give --output, --json, or leave --quiet out")

    from .view_factors import view_factors as compute_view_factors

    def study(scene: "AnyScene") -> "tuple[ViewFactors, float]":
        factors = compute_view_factors(
            scene, args.surfaces, samples=args.samples, side=args.side, seed=args.seed, time=args.time,
            threads=args.threads,
        )  # fmt: skip
        return factors.reciprocal() if args.reciprocal else factors, factors.reciprocity_error

    with StudyRun(args) as run:
        scene, _ = run.open(spec, to_memory=True)
        result, sampled = run.timed(study, scene)
        run.save(result.save, outputs)
    rays = len(result) * result.about["samples"]
    if args.json:
        answer = {**result.about, "n": len(result), "area": float(result.areas.sum()), "rays": rays}
        answer |= {"factors": result.factors.nnz, "sampled_reciprocity_error": sampled, "seconds": run.seconds}
        console.print_json({**answer, "outputs": run.written})
    elif not args.quiet:
        _print(result, sampled, run.rows(rays))
    return 0


def _print(result: "ViewFactors", sampled: float, rows_of_run: list[tuple[str, str]]) -> None:
    names = "surface", "area, m2", "surfaces", "sky", "ground", "other"
    inside = result.factors.sum(axis=1)
    columns = result.areas, inside, result.sky, result.ground, result.other
    rows = [
        (name, f"{area:,.6g}", *(f"{share:.4f}" for share in shares))
        for name, area, *shares in zip(result.names[:_MOST], *(column[:_MOST].tolist() for column in columns))
    ]
    console.print_table(names, rows, right=(1, 2, 3, 4, 5))
    fields = [("surfaces", f"{len(result):,}"), ("view factors", f"{result.factors.nnz:,}")]
    fields.append(
        ("reciprocity error", f"{sampled:.2%} before, 0 after" if "reciprocal" in result.about else f"{sampled:.2%}")
    )
    console.print_fields(fields + rows_of_run)
