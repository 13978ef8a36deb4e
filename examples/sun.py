"""Hours of sun of a city in spring, and where a garden gets enough: python examples/sun.py [FOLDER]

It needs pvlib for the position of the sun: pip install 'antumbra[sun]'
"""

import os
import sys
import tempfile
from pathlib import Path

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
city = Path(os.environ.get("ANTUMBRA_SCENES", "")) / "delft_city" / "scene.glb"
scene = at.load(city, up="z") if city.is_file() else at.procedural("city", triangles=20_000)
place = at.Place(52.0116, 4.3571, north=0.81, timezone="Europe/Amsterdam")

# BR 209: at least half of a garden gets two hours of sun on 21 March. Here, each cell of a raster at the ground.
table = at.sun_hours(scene, "raster:2", place=place, rule="br209-amenity")
there = table.sensors.covered  # not the cells beside the model
print(
    f"{table.about['suns']} suns, {there.sum():,} sensors, {table['passes'][there].mean():.0%} with two hours and more"
)

table.save(folder / "sun.png")
table.save(folder / "sun.csv")
print(f"{table['sun_hours'][there].mean():.1f} h on average; written: {folder / 'sun.png'}")
