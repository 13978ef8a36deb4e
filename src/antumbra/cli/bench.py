"""``antumbra bench``: what the papers measured, measured on this machine, with their figures beside ours."""

import typer

from . import bench_chcrt, bench_culling, bench_ray_hierarchy, bench_srdh

app = typer.Typer(help="Measure what the papers measured.", rich_markup_mode=None)
app.command("chc-rt")(bench_chcrt.chc_rt)
app.command("pre-bvh-culling")(bench_culling.pre_bvh_culling)
app.command("ray-hierarchy")(bench_ray_hierarchy.ray_hierarchy)
app.command("srdh")(bench_srdh.srdh)


@app.callback()
def _bench() -> None:
    """Tables and plots of the papers, measured here, with the papers' figures beside."""
