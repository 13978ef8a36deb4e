"""A wind farm seen from a raster, and the shade on rows of modules: python examples/wind_and_pv.py [FOLDER]

Requires rasterio, pyproj and pvlib: pip install 'antumbra[sun,gis]'
"""

import sys
import tempfile
from pathlib import Path

import pandas

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
hills = at.examples.hills()

# Three turbines on the hills, seen by people on a raster of 20 m, over the curved earth.
(x0, y0, _), (x1, y1, _) = hills.bounds
feet = [(x0 + share * (x1 - x0), (y0 + y1) / 2.0, 0.0) for share in (0.25, 0.5, 0.75)]
farm = {f"WT{k}": at.Turbine(foot, hub_height=60.0, rotor_diameter=50.0) for k, foot in enumerate(feet, 1)}
table = at.visible_share(hills, "raster:20+1.6", farm, on_surface=True, curvature=True)
table.save(folder / "farm.tif", column="turbines")
seen, share = table["turbines"].mean(), table["share"].mean()
print(f"of 3 turbines, {seen:.2f} are in sight on average, and {share:.0%} of the rotors")

# Three rows of modules in the valley: the second and the third stand in the shade of those in front.
x, y = 85_000.0, 446_000.0
z = 500.0 - float(hills.closest_hit((x, y, 500.0), (0.0, 0.0, -1.0)).t)
rows = {
    f"row {k}": at.PvModule((x, y + 4.0 * k, z + 1.5), width=20.0, height=2.0, tilt=25.0, string="A") for k in range(3)
}
times = pandas.date_range("2026-12-21 09:30", periods=7, freq="h", tz="Europe/Amsterdam")
place = at.place_of(hills, timezone="Europe/Amsterdam")
shading = at.pvlib_shading(hills, rows, times, place=place)
print(shading["shaded_fraction"].unstack("module").round(2))
at.module_shading(hills, rows, times, place=place, per="string").save(folder / "string.csv")

# The first and the last sun of a week in winter, behind the hills.
week = at.sun_calendar(hills, [[x, y, 0.0]], "2026-12-18:2026-12-24", place=place, on_surface=True)
week.save(folder / "calendar.csv")
print(f"on 21 December, the sun comes at {str(week.first[0, 3])[11:]} and goes at {str(week.last[0, 3])[11:]}")
print("written: farm.tif, string.csv and calendar.csv")
