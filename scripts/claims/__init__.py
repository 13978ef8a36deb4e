"""The claims of the five papers, each with an expression for our number and a test that gives the verdict."""

from . import chc_rt, multi_frusta, pre_bvh_culling, ray_hierarchy, srdh
from .claim import Claim, Condition

_PAPERS = {
    "multi-frusta": multi_frusta,
    "pre-bvh-culling": pre_bvh_culling,
    "srdh": srdh,
    "ray-hierarchy": ray_hierarchy,
    "chc-rt": chc_rt,
}

CLAIMS: dict[str, tuple[Claim, ...]] = {name: paper.CLAIMS for name, paper in _PAPERS.items()}
"""Benchmark -> the claims of its paper."""

CONDITIONS: dict[str, tuple[Condition, ...]] = {name: paper.CONDITIONS for name, paper in _PAPERS.items()}
"""Benchmark -> what to know about its numbers."""
