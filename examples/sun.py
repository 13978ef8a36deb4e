"""Sun hours of a city in spring, and whether a garden and dwellings get enough: python examples/sun.py [FOLDER]

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

# Daylight rules judge windows, and a dwelling by its windows: the middle of each, where it faces, and columns of yours.
lines = ["id,dwelling,x,y,z,nx,ny,nz"]
lines += [f"w{k},{'A' if k < 3 else 'B'},{4 * k},0,{1.5 + 3 * (k % 3)},0,-1,0" for k in range(6)]
(folder / "windows.csv").write_text("\n".join(lines) + "\n")
block = at.Scene.from_arrays(
    [[-9, -9, 0], [40, -9, 0], [40, -9, 12], [-9, -9, 12]], [[0, 1, 2], [0, 2, 3]], up="z"
)  # 12 m high, 9 m in front of the windows
rules = ["br209-vsc", "en17037-minimum"]
homes = at.sun_hours(block, str(folder / "windows.csv"), rule=rules, lowest=11.0, place=place, per="dwelling")
for k, name in enumerate(homes.sensors.attributes["dwelling"]):
    verdicts = {rule: bool(homes[rule.replace("-", "_") + "_passes"][k]) for rule in rules}
    print(f"dwelling {name}: {verdicts}, {homes['br209_vsc'][k]:.1f} % vertical sky component")
homes.save(folder / "homes.csv")
print(f"written: {folder / 'sun.png'}")
