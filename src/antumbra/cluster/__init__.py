"""Jobs on the nodes of a Ray cluster (``pip install 'antumbra[ray]'``).

- calls: `run`, a function of this package on a cluster
- engine: the engine; crew: hands units to nodes, hears of them, and replaces workers that are lost
- node: what happens on a node; inputs: its files, by path or fetched; named: the files that arguments name
- survey: what nodes have
"""

from .ray_executor import Cluster, connected, run

__all__ = ["Cluster", "connected", "run"]
