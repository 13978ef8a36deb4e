"""Work on a Ray cluster (``pip install 'antumbra[ray]'``).

- `ray_executor`: the executor that distributes units over a cluster, and `run`, which calls a function with it
- `ray_workers`: the worker of a node, the pool that assigns units to workers and replaces lost ones, and `survey`
- `node_files`: the input files of some work on a node, opened by path or fetched
"""

from .ray_executor import Cluster, connected, run

__all__ = ["Cluster", "connected", "run"]
