"""Work on a Ray cluster (``pip install 'antumbra[ray]'``).

- `ray_executor`: the executor that distributes units over a cluster, and `run`, which calls a function with it
- `worker_pool`: the pool that assigns units to workers, watches them, and replaces lost ones
- `ray_workers`: the worker of a node, the probe that precedes it, and `survey`
- `own_stdout`: standard output without what Ray prints
- `node_files`: the input files of some work on a node, opened by path or fetched
"""

from .ray_executor import Cluster, connected, run

__all__ = ["Cluster", "connected", "run"]
