"""A bake into attributes of vertices."""

from pathlib import Path

import numpy as np

from ...files import atomic_output
from ..engines import Engine
from .edit import all_rows, change_materials, make_unlit, own_primitives, write_colours
from .hidden import Solids
from .measure import Measurement, Meter, curve_blocks
from .options import Options, exposure_of
from .parts import Part, accessors_of, to_local
from .report import Baked, Clock
from .sources import Opened
from .vertices import receivers_of, replace_hidden


def bake_vertices(source: Opened, options: Options, output: Path, clock: Clock, engine: Engine) -> Baked | None:
    """Measure the vertices of all parts, and write the file; None if the engine leaves vertices to others."""
    scene, asset, parts = source
    meter = Meter(scene, options.asked, sum(len(p.positions) for p in parts))
    receivers = receivers_of(parts)
    measured = Measurement(meter, receivers, curve_blocks(receivers.positions), False, engine.folder)
    if not engine.finish([measured.parts]):
        return None
    solids = None if options.keep_hidden else Solids(scene, options.asked.time, options.asked.threads)
    values = measured.result()
    hidden = replace_hidden(values, receivers, parts, meter, solids)
    clock.lap("trace")
    exposure = exposure_of(values, options)
    accessors, primitives = accessors_of(asset, scene.name), own_primitives(asset, parts)
    for part, primitive, own in zip(parts, primitives, _split(values, parts)):
        if options.asked.what == "bent-normal":
            own = to_local(own, part)
        if options.attribute == "COLOR_0":
            shown = 0.5 + 0.5 * own if options.asked.what == "bent-normal" else own * exposure
            write_colours(asset, accessors, primitive, all_rows(part, shown), options.multiply)
        else:
            rows = all_rows(part, own)
            primitive["attributes"][options.attribute] = asset.accessor(rows[:, 0] if rows.shape[1] == 1 else rows)
    if options.attribute == "COLOR_0" and options.asked.what in ("shadow", "sun", "light"):
        change_materials(asset, primitives, [None] * len(primitives), lambda material, _: make_unlit(asset, material))
    with atomic_output(output) as file:
        file.write_bytes(asset.glb())
    engine.end([measured.parts])
    clock.lap("write")
    return Baked(output, [], options.asked.what, options.attribute, len(parts), len(values), hidden, meter.rays,
                 float(values.mean()), exposure, None, clock.seconds)  # fmt: skip


def _split(values: np.ndarray, parts: list[Part]) -> list[np.ndarray]:
    return np.split(values, np.cumsum([len(p.positions) for p in parts])[:-1])
