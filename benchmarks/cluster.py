"""Scaling of a job over cluster nodes: measured on small local nodes, and simulated for many.

    python benchmarks/cluster.py [scene] [--nodes N ...] [--size WxH] [--spp N] [--store GB] [--json FILE]

For each N, it starts a local Ray cluster of N one-core nodes and renders one picture in row bands with ``--ray``. The
machine should be idle and have one more core than there are nodes.

- `work`: seconds from when a worker is ready until the last part is written, summed over workers
- `parts`: total seconds that nodes spent on parts, without scheduling, transfers, and waiting for the last part
- `of ideal`: parts / work

The simulation resamples the measured part times to the size of a larger job and schedules them as the engine does. A
node is ready after its worker has started and it has fetched the store from one machine. One node in fifty is a
straggler, three times slower. `docs/jobs/cluster.md` has the table.
"""

import heapq
import json
import os
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

import numpy as np

from antumbra.cli.shards import begin
from antumbra.cluster import Cluster, connected
from antumbra.work.executors import UnitCollector, numbered
from common import arguments, machine

SIMULATED = 8, 64, 512  # nodes
START = 8.0  # seconds from the command to a ready worker: starting Ray's actor and importing the package
WIDE, NARROW = 1.25e9, 1.25e8  # bytes per second that the driver sends and a node writes: 10 and 1 Gbit/s
SLOW, SLOWER = 0.02, 3.0  # share of stragglers, and how much longer their parts take
_MEMORY = 80 << 20  # bytes of a node's object store


def measured(words: list[str], nodes: int, folder: Path) -> dict:
    """Run a command's job on one-core nodes; return the seconds of its phases and of each part."""
    from ray.cluster_utils import Cluster as Nodes

    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    head = {"num_cpus": 0, "object_store_memory": _MEMORY, "include_dashboard": False}
    cluster = Nodes(initialize_head=True, head_node_args=head)
    for _ in range(nodes):
        cluster.add_node(num_cpus=1, object_store_memory=_MEMORY)
    cluster.wait_for_nodes()
    try:
        with connected(cluster.address):
            given = command_arguments(words)
            request, prepare = UnitCollector(folder / f"{nodes}.shards"), partial(begin, type(given).run, given)
            prepare({}, 1, request)
            engine = Cluster(request.folder, cluster.address, prepare, {}, given.plan)
            start = monotonic()
            engine.finish(request.job)
    finally:
        cluster.shutdown()
    log = engine.log
    end = max(log.written)
    work = sum(end - moment for moment in log.ready.values())
    parts = [log.seconds[number] for number, _, _ in numbered(request.job)]
    ready = sorted(moment - start for moment in log.ready.values())
    return {"nodes": nodes, "ready": ready, "work": work, "parts": parts, "of_ideal": sum(parts) / work}


def command_arguments(words: list[str]):
    """The arguments of ``antumbra render`` with these words."""
    from antumbra.cli import render_command  # noqa: F401 - gives the arguments their command
    from antumbra.cli.picture_spec import RenderArguments

    names = dict(zip(words[1::2], words[2::2]))
    values = {"scene": words[0], "size": names["--size"], "spp": int(names["--spp"]), "output": Path("a.exr")}
    return RenderArguments(**values, quiet=True)


def simulated(parts: list[float], nodes: int, store: float, seed: int = 1) -> dict:
    """The seconds of a job on `nodes` nodes, and the share of ideal: total part time over nodes x seconds.

    parts : seconds of each part on one node
    store : bytes that each node fetches from the driver
    """
    rng = np.random.default_rng(seed)
    pace = np.where(rng.random(nodes) < SLOW, SLOWER, 1.0)
    fetch = store / min(NARROW, WIDE / nodes)
    free = [(START + fetch, node) for node in range(nodes)]
    heapq.heapify(free)
    end = 0.0
    for seconds in parts:
        moment, node = heapq.heappop(free)
        moment += seconds * pace[node]
        end = max(end, moment)
        heapq.heappush(free, (moment, node))
    return {"nodes": nodes, "seconds": end, "start": START + fetch, "of_ideal": sum(parts) / (nodes * end)}


def larger(parts: list[float], hours: float) -> list[float]:
    """Resampled parts that take one node this many hours."""
    rng = np.random.default_rng(2)
    return rng.choice(parts, max(1, round(hours * 3600.0 / np.mean(parts)))).tolist()


def plot(parts: list[float], options) -> None:
    """Draw the share of ideal over the number of nodes."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6.4, 3.2), dpi=100)
    nodes = [2**k for k in range(10)]
    for hours in options.hours:
        job = larger(parts, hours)
        for store, style in zip(options.store, ("-", "--")):
            shares = [simulated(job, n, store * 1e9)["of_ideal"] for n in nodes]
            axes.plot(nodes, shares, style, marker="o", label=f"{hours:g} h of one node, {store:g} GB to fetch")
    axes.set_xscale("log", base=2)
    axes.set_xticks(nodes, nodes)
    axes.set(xlabel="nodes", ylabel="share of ideal speed", ylim=(0.0, 1.05))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(options.plot)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--plot", type=Path, help="plot the simulation to a .png file")
    parser.add_argument("--nodes", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--size", default="1024x1024")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--store", type=float, nargs="+", default=[0.0, 4.0], help="GB that nodes fetch")
    parser.add_argument("--hours", type=float, nargs="+", default=[1.0, 24.0], help="of one node")
    options = parser.parse_args()
    scene = str(options.scene[0]) if options.scene else "procedural:city?triangles=200k"
    words = [scene, "--size", options.size, "--spp", str(options.spp)]
    rows = []
    for nodes in options.nodes:
        with TemporaryDirectory() as folder:
            rows.append(measured(words, nodes, Path(folder)))
        row = rows[-1]
        print(
            f"{nodes} nodes: ready {row['ready'][-1]:.1f} s, work {row['work']:.2f} s, parts "
            f"{sum(row['parts']):.2f} s, {row['of_ideal']:.3f} of ideal"
        )
    print(f"{'nodes':>5} {'hours':>6} {'store':>6} {'seconds':>9} {'start':>7} {'of ideal':>8}")
    table = []
    for hours in options.hours:
        parts = larger(rows[0]["parts"], hours)
        for store in options.store:
            for nodes in SIMULATED:
                result = simulated(parts, nodes, store * 1e9)
                table.append({"hours": hours, "store": store, **result})
                print(
                    f"{nodes:5} {hours:6g} {store:6g} {result['seconds']:9.1f} {result['start']:7.1f} "
                    f"{result['of_ideal']:8.3f}"
                )
    if options.plot:
        plot(rows[0]["parts"], options)
    if options.json:
        options.json.write_text(json.dumps({"rows": rows, "simulated": table, "about": machine(1)}))


if __name__ == "__main__":
    main()
