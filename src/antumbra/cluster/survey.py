"""What the nodes of a cluster have, for ``antumbra doctor``."""

import os
import platform
import shutil
import tempfile
from typing import Any

from ..engine.precompilation import missing_of
from ..kernels.toolchain import kernel_manifest as needs
from ..kernels.toolchain.kernel_cache import user_cache
from ..version import VERSION
from .crew import on_node


def about_node() -> dict[str, Any]:
    """What this machine has for a job: cores, memory and room in GiB, this package, and its compiled kernels."""
    wanted = needs.read_manifests(needs.MANIFEST).kernels
    found: dict[str, Any] = {"host": platform.node(), "cores": os.cpu_count(), "memory": _memory()}
    found |= {"room": shutil.disk_usage(tempfile.gettempdir()).free / 2**30, "antumbra": VERSION}
    return {**found, "missing": len(missing_of(wanted)), "cache": str(user_cache().path)}


def _memory() -> float | None:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
    except (AttributeError, OSError, ValueError):  # not on Windows
        return None


def survey(ray, seconds: float = 60.0) -> list[dict[str, Any]]:
    """What each node of the cluster has, in the order of hosts; "error" of those that do not answer."""
    ask = ray.remote(about_node)
    calls = {}
    for node in ray.nodes():
        if node["Alive"]:
            call = ask.options(num_cpus=0, max_retries=0, scheduling_strategy=on_node(ray, node["NodeID"])).remote()
            calls[call] = node["NodeManagerHostname"], int(node["Resources"].get("CPU", 0))
    ready, late = ray.wait(list(calls), num_returns=len(calls), timeout=seconds)
    found = [{"host": calls[call][0], "error": f"no answer in {seconds:g} s"} for call in late]
    for call in ready:
        host, cores = calls[call]
        try:
            found.append({**ray.get(call), "cores": cores})
        except ray.exceptions.RayError as error:
            found.append({"host": host, "error": " ".join(str(error).split())[:160]})
    return sorted(found, key=lambda each: each["host"])
