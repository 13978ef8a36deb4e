"""How much sun a new building costs its neighbours, per dwelling: python examples/before_and_after.py [FOLDER]

Requires pvlib for the position of the sun: pip install 'antumbra[sun,gis]'
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
village = at.examples.village()
place = at.place_of(village, timezone="Europe/Amsterdam")

# Flats of 14 m x 9 m x 18 m take the place of a house. Their corners count from an origin of their own.
corners = np.array([[x, y, z] for x in (0, 14) for y in (0, 9) for z in (0, 18)], float)
quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
flats = at.Scene.from_arrays(corners, faces, up="z", name="flats")
change = at.scene_change(village, add=[(flats, (84903, 445970, 22))], remove=["house-02"])
print(*change.notes, sep="\n")

# Four south windows of the house across the street.
(folder / "windows.csv").write_text(
    "id,dwelling,x,y,z,nx,ny,nz\n"
    "w1,ground floor,84907,445992.2,22.5,0,-1,0\n"
    "w2,ground floor,84913,445992.2,22.5,0,-1,0\n"
    "w3,attic,84907,445992.2,25.5,0,-1,0\n"
    "w4,attic,84913,445992.2,25.5,0,-1,0\n"
)
windows = at.sensors_of(str(folder / "windows.csv"), village)
study = {"days": "2026-03-21", "step": 10, "place": place}
table = change.compare(at.sun_hours, windows, **study)
for name, before, after in zip(table.sensors.attributes["id"], table["sun_hours_before"], table["sun_hours"]):
    print(f"{name}: {before:.1f} h before, {after:.1f} h after")
homes = change.compare(at.sun_hours, windows, **study, per="dwelling")
homes.save(folder / "dwellings.csv")

everything = change.compare(at.sun_hours, "grid:1", **study)  # on the surfaces that both states share
lost = everything["sun_hours_loss"]
print(
    f"{(lost > 0).sum():,} of {len(lost):,} sensors lose sun, {(lost < 0).sum():,} gain some; up to {lost.max():.1f} h"
)
everything.save(folder / "loss.png")
print(f"written: {folder / 'loss.png'}, {folder / 'dwellings.csv'}")
