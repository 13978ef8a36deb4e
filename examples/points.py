"""Daily sun hours at sensors in a city: python examples/points.py [FOLDER]

Requires pvlib for the position of the sun: pip install 'antumbra[sun]'
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas
import pvlib

import antumbra as at

LATITUDE, LONGITUDE = 52.0, 4.4  # Delft
STEP = 0.5  # hours

scene = at.procedural("city", triangles=10_000)

# A grid of sensors, projected down onto roofs and the ground.
(x0, y0, z0), (x1, y1, z1) = scene.bounds
x, z = np.meshgrid(np.linspace(x0, x1, 42)[1:-1], np.linspace(z0, z1, 42)[1:-1], indexing="ij")
above = np.stack([x, np.full_like(x, y1 + 1.0), z], axis=-1)
height = scene.closest_hit(above, (0.0, -1.0, 0.0)).t
sensors = above[np.isfinite(height)]
sensors[:, 1] -= height[np.isfinite(height)]

# The position of the sun: +X is east, +Y is up, -Z is north.
times = pandas.date_range("2025-03-20", periods=int(24 / STEP), freq=f"{STEP}h", tz="UTC")
sun = pvlib.solarposition.get_solarposition(times, LATITUDE, LONGITUDE)
azimuth, elevation = np.radians(sun["azimuth"]), np.radians(sun["apparent_elevation"])
towards = np.stack(
    [np.sin(azimuth) * np.cos(elevation), np.sin(elevation), -np.cos(azimuth) * np.cos(elevation)], axis=-1
)

hours = np.zeros(len(sensors))
for direction in towards[towards[:, 1] > 0.0]:
    light = at.DirectionalLight(direction=-direction)
    hours += STEP * at.visibility(scene, sensors, light, normals=(0, 1, 0), spp=16).fraction

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
table = np.column_stack([sensors, hours])
np.savetxt(folder / "sun_hours.csv", table, "%.3f", delimiter=",", header="x,y,z,hours", comments="")
print(f"{len(sensors)} sensors: {hours.min():.1f} to {hours.max():.1f} hours of sun, {hours.mean():.1f} on average")
print(f"written: {folder / 'sun_hours.csv'}")
