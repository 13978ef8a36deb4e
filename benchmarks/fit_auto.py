"""Measures the tracers of the plan `auto` on random queries, and fits their costs to them.

    python benchmarks/fit_auto.py measure FILE [--seed N] [--cases N] [--only TEXT] [--scenes NAME ...] [--size W H]
    python benchmarks/fit_auto.py fit FILE... [--output FILE]

`measure` writes one line of JSON per query and tree: the features of the query, and the nanoseconds per ray that each
tracer takes on one thread, in trees by `lbvh` and `bsah`, with and without culling. `fit` prints their error on scenes
that it leaves out, and the rate and the reference of each tracer, as they stand in its `cost`. `--output` also writes
them as JSON.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from time import process_time

import numpy as np

from antumbra.engine.auto.cost_model import strategies
from antumbra.engine.auto.query_features import features_of, reorder_query, sample_of, spatial_order
from antumbra.engine.auto.strategies import (
    SceneExtent,
    TreeForms,
    answer_query,
    suitable_strategies,
)
from antumbra.engine.calibration import ray_times, small_queries
from antumbra.engine.engine import Engine
from antumbra.engine.method_registry import BUILDERS, TRACERS
from antumbra.engine.sources.source_protocols import FrameMemory
from antumbra.query.light_samples import light_samples
from antumbra.query.query_bounds import bounds
from antumbra.query.shadow_query import ShadowQuery, new_bits, ray_count, surface_queries
from antumbra.scene.triangles import Triangles
from antumbra.techniques.culling.pre_bvh_culling import CullResult, cull, soup_of
from antumbra.trace.tracer_cost import QueryFeatures, terms
from auto import Case, arguments, cases_of, lights_of, receivers_of, region_of, view_of

WINDOWS = 48  # of the sample of a query
SLOW = 8.0  # strategies slower than this multiple of the best are not measured again


def queries_of(case: Case) -> tuple[Triangles, list[ShadowQuery]]:
    """The triangles and the queries of a case."""
    region = region_of(case.scene)
    engine, lights = Engine(region.scene, "lbvh+single", 2, gbuffer="raster"), lights_of(case, region)
    if case.job in ("points", "surface"):
        samples = [light_samples(each, case.spp) for each in lights]
        queries = engine.queries(receivers_of(case), lights, samples)
        order = spatial_order(queries[0].origins[0])
        return region.scene.triangles(0.0), [queries[0], reorder_query(queries[0], order)]
    tracer, camera = engine.frame_tracer(), view_of(case)
    tracer.begin(FrameMemory(0, 0, 0), 0, 0, 0.0)
    surfaces = tracer.surfaces(camera, slice(0, camera.height))
    return tracer.triangles, surface_queries(surfaces, lights, [light_samples(each, case.spp) for each in lights])


def rate(name: str, forms: TreeForms, query: ShadowQuery) -> float:
    """Nanoseconds per ray of one thread, the better of two runs."""
    seconds = []
    for _ in range(2):
        start = process_time()
        answer_query(name, forms, query, 1)
        seconds.append(process_time() - start)
    return 1e9 * min(seconds) / max(ray_count(query), 1)


def cone_seconds(triangles: Triangles, culled: CullResult | None, query: ShadowQuery) -> float:
    """Seconds of one thread for a whole query by cones."""
    start = process_time()
    TRACERS["cones"].trace(soup_of(triangles, culled), query, new_bits(query), 1, None, None)
    return process_time() - start


def rows_of(case: Case) -> Iterator[dict]:
    """A row for each query of a case."""
    triangles, queries = queries_of(case)
    extent = SceneExtent(len(triangles.vertices), np.stack(bounds(triangles.vertices)))
    culled = cull(triangles, queries, 2)
    for query in queries[: 1 + (case.job in ("points", "surface"))]:
        if not ray_count(query):
            continue
        sample, rates = sample_of(query, WINDOWS), dict[str, dict[str, float]]()
        for build, corners in (("lbvh", triangles.vertices), ("bsah", triangles.vertices), ("culled", culled.vertices)):
            forms = TreeForms(BUILDERS["bsah" if build == "bsah" else "lbvh"].build(corners, 2), 2, extent)
            rates[build] = {}
            for name in suitable_strategies(query, extent.box):
                if build == "lbvh" or name in rates["lbvh"]:
                    rates[build][name] = rate(name, forms, sample)
            least = min(rates["lbvh"].values())
            rates["lbvh"] = {name: each for name, each in rates["lbvh"].items() if each < SLOW * least}
        row = {"scene": case.scene, "job": case.job, "light": case.light, "camera": case.camera, "rates": rates}
        row |= {"features": features_of(query, *extent)._asdict(), "kept": len(culled.kept)}
        if case.light in ("point", "small", "sun") and case.spp <= 4:
            row["cones"] = [cone_seconds(triangles, None, query), cone_seconds(triangles, culled, query)]
        yield row


# --- fit --------------------------------------------------------------------------------------------------------------

RIDGE = 0.03  # weight of the squared sizes of the weights, relative to that of the squared errors


def fitted(values: np.ndarray, logs: np.ndarray) -> np.ndarray:
    """(k,) weights of the terms `values`, (n, k), of which the first is 1, for the logarithms of rates, (n,)."""
    mean, scale = values.mean(0), values.std(0) + 1e-9
    mean[0], scale[0] = 0.0, 1.0
    z = (values - mean) / scale
    penalty = RIDGE * len(z) * np.eye(z.shape[1])
    penalty[0, 0] = 0.0
    weights = np.linalg.solve(z.T @ z + penalty, z.T @ logs) / scale
    weights[0] -= weights[1:] @ mean[1:]
    return weights


def fit(rows: list[dict]) -> dict[str, list[float]]:
    """Tracer -> weights of all rows; prints how much is lost by predictions for scenes that are left out."""
    values = np.array([terms(QueryFeatures(**row["features"])) for row in rows])
    scenes = np.array([row["scene"] for row in rows])
    names = [name for name in strategies() if any(name in row["rates"]["lbvh"] for row in rows)]
    logs = np.array([[np.log(row["rates"]["lbvh"].get(name, np.inf)) for name in names] for row in rows])
    predicted = np.full(logs.shape, np.inf)
    for k in range(len(names)):
        known = np.isfinite(logs[:, k])
        for scene in np.unique(scenes):
            others, here = known & (scenes != scene), known & (scenes == scene)
            if not others.any():
                continue
            predicted[here, k] = values[here] @ fitted(values[others], logs[others, k])
        error = predicted[known, k] - logs[known, k]
        print(f"{names[k]:18s} {known.sum():4d} rows, error {np.exp(error.std()):.2f} x")
    chosen = logs[np.arange(len(logs)), predicted.argmin(1)] - logs.min(1)
    loss, most = np.exp(chosen.mean()), np.exp(np.quantile(chosen, 0.9))
    print(f"predictions alone lose {loss:.3f} x, nine of ten less than {most:.2f} x")
    return {
        name: fitted(values[known], logs[known, k]).tolist()
        for k, name in enumerate(names)
        for known in [np.isfinite(logs[:, k])]
    }


def main() -> None:
    parser = arguments(1, 600)
    parser.add_argument("command", choices=("measure", "fit"))
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    if options.command == "fit":
        rows = [json.loads(line) for file in options.files for line in file.read_text().splitlines()]
        weights = fit(rows)
        reference = ray_times(*small_queries()[:2])
        for name, values in weights.items():
            print(f"{name}: rate=FittedRate({', '.join(map(str, values))}), reference={reference.get(name)}")
        if options.output is not None:
            options.output.write_text(json.dumps({"weights": weights, "reference": reference}, indent=1) + "\n")
        return
    with options.files[0].open("a") as file:
        for case in sorted((c for c in cases_of(options) if c.job != "moving"), key=lambda case: case.scene):
            for row in rows_of(case):
                file.write(json.dumps(row, default=float) + "\n")
                file.flush()


if __name__ == "__main__":
    main()
