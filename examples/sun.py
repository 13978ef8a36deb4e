"""Hours of sun in a city in spring, and whether a garden gets enough: python examples/sun.py [FOLDER]

Requires pvlib for the position of the sun: pip install 'antumbra[sun]'
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

table = at.sun_hours(scene, "raster:2", "2026-03-21", step=5, place=place)
there = table.sensors.covered  # without cells outside the model
print(f"{table.about['suns']} suns, {there.sum():,} sensors, {table['sun_hours'][there].mean():.1f} h on average")
table.save(folder / "sun.png")
table.save(folder / "sun.csv")

# BR 209: at least half of a garden gets two hours of sun on 21 March. Cells inside buildings do not count.
garden = {"garden": [(20, -40), (60, -40), (60, 0), (20, 0)]}
(result,) = at.sun_hours(scene, "raster:1", rule="br209-amenity", areas=garden, place=place).about["areas"]
print(f"{result['share']:.0%} of the garden gets two hours; {result['left_out']} cells are inside buildings")
print(f"written: {folder / 'sun.png'}")
