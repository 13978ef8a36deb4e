"""Scaling of a job over the nodes of a cluster: measured on small local nodes, and simulated for many.

    python benchmarks/cluster.py [scene] [--nodes N ...] [--size WxH] [--spp N] [--store GB] [--json FILE]

It starts a Ray cluster of N nodes with one core each on this machine, for each N, and renders one picture in bands of
rows with ``--ray``. A machine should have a core more than there are nodes, and nothing else to do.

- `work`: seconds from the moment when a worker is ready until the last part is written, summed over workers
- `parts`: the sum of the seconds that nodes took for parts, without handing out, sending, and waiting for the last one
- `of ideal`: parts / work

The simulation takes the measured seconds of the parts, repeats them to the number of parts of a larger job, and hands
them out as the engine does. Nodes become ready after the start of a worker, and the fetch of a store from one machine.
One node in fifty is three times slower (a straggler). `docs/jobs/cluster.md` has its table.
"""

import heapq
import json
import os
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

import numpy as np

from antumbra.cli import render_command as render
from antumbra.cli.shards import begin
from antumbra.cluster import Cluster, connected
from antumbra.jobs.executors import UnitCollector, numbered
from common import arguments, machine

SIMULATED = 8, 64, 512  # nodes
START = 8.0  # seconds from the command to a ready worker: Ray's actor, and the import of the package
WIDE, NARROW = 1.25e9, 1.25e8  # bytes a second that the driver's machine sends, and that a node writes: 10 and 1 Gbit/s
SLOW, SLOWER = 0.02, 3.0  # share of stragglers, and how much longer their parts take
_MEMORY = 80 << 20  # bytes of a node's object store


def measured(words: list[str], nodes: int, folder: Path) -> dict:
    """Do the job of a command on so many nodes of one core: seconds of its phases and of each part."""
    from ray.cluster_utils import Cluster as Nodes

    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    head = {"num_cpus": 0, "object_store_memory": _MEMORY, "include_dashboard": False}
    cluster = Nodes(initialize_head=True, head_node_args=head)
    for _ in range(nodes):
        cluster.add_node(num_cpus=1, object_store_memory=_MEMORY)
    cluster.wait_for_nodes()
    try:
        with connected(cluster.address):
            home, given = asked_of(words)
            own = UnitCollector(folder / f"{nodes}.shards")
            begin(home, given, {}, 1, own)
            engine = Cluster(own.folder, cluster.address, partial(begin, home, given), {}, given.plan)
            start = monotonic()
            engine.finish(own.job)
    finally:
        cluster.shutdown()
    log = engine.log
    end = max(log.written)
    work = sum(end - moment for moment in log.ready.values())
    parts = [log.seconds[number] for number, _, _ in numbered(own.job)]
    ready = sorted(moment - start for moment in log.ready.values())
    return {"nodes": nodes, "ready": ready, "work": work, "parts": parts, "of_ideal": sum(parts) / work}


def asked_of(words: list[str]):
    """The home and the arguments of ``antumbra render`` with these words."""
    from antumbra.cli.picture_spec import RenderArguments

    names = dict(zip(words[1::2], words[2::2]))
    values = {"scene": words[0], "size": names["--size"], "spp": int(names["--spp"]), "output": Path("a.exr")}
    return (render.__name__, "render"), RenderArguments(**values, quiet=True)


def simulated(parts: list[float], nodes: int, store: float, seed: int = 1) -> dict:
    """The seconds of a job on so many nodes, and the share of ideal: the sum of its parts over nodes x seconds.

    parts : seconds of each part on one node
    store : bytes that each node fetches from the driver's machine
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
    """Parts like the measured ones, so many that one node works on them for some hours."""
    rng = np.random.default_rng(2)
    return rng.choice(parts, max(1, round(hours * 3600.0 / np.mean(parts)))).tolist()


def plot(parts: list[float], asked) -> None:
    """Draw the share of ideal over the number of nodes."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6.4, 3.2), dpi=100)
    nodes = [2**k for k in range(10)]
    for hours in asked.hours:
        job = larger(parts, hours)
        for store, style in zip(asked.store, ("-", "--")):
            shares = [simulated(job, n, store * 1e9)["of_ideal"] for n in nodes]
            axes.plot(nodes, shares, style, marker="o", label=f"{hours:g} h of one node, {store:g} GB to fetch")
    axes.set_xscale("log", base=2)
    axes.set_xticks(nodes, nodes)
    axes.set(xlabel="nodes", ylabel="share of ideal speed", ylim=(0.0, 1.05))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(asked.plot)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--plot", type=Path, help="draw the simulation here, .png")
    parser.add_argument("--nodes", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--size", default="1024x1024")
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--store", type=float, nargs="+", default=[0.0, 4.0], help="GB that nodes fetch")
    parser.add_argument("--hours", type=float, nargs="+", default=[1.0, 24.0], help="of one node")
    asked = parser.parse_args()
    scene = str(asked.scene[0]) if asked.scene else "procedural:city?triangles=200k"
    words = [scene, "--size", asked.size, "--spp", str(asked.spp)]
    rows = []
    for nodes in asked.nodes:
        with TemporaryDirectory() as folder:
            rows.append(measured(words, nodes, Path(folder)))
        told = rows[-1]
        print(f"{nodes} nodes: ready {told['ready'][-1]:.1f} s, work {told['work']:.2f} s, parts "
              f"{sum(told['parts']):.2f} s, {told['of_ideal']:.3f} of ideal")  # fmt: skip
    print(f"{'nodes':>5} {'hours':>6} {'store':>6} {'seconds':>9} {'start':>7} {'of ideal':>8}")
    table = []
    for hours in asked.hours:
        parts = larger(rows[0]["parts"], hours)
        for store in asked.store:
            for nodes in SIMULATED:
                found = simulated(parts, nodes, store * 1e9)
                table.append({"hours": hours, "store": store, **found})
                print(f"{nodes:5} {hours:6g} {store:6g} {found['seconds']:9.1f} {found['start']:7.1f} "
                      f"{found['of_ideal']:8.3f}")  # fmt: skip
    if asked.plot:
        plot(rows[0]["parts"], asked)
    if asked.json:
        asked.json.write_text(json.dumps({"rows": rows, "simulated": table, "about": machine(1)}))


if __name__ == "__main__":
    main()
