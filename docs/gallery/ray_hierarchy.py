"""A hierarchy over rays

The tracer `cones` builds no tree over the scene, but one over the shadow rays. This section through an atrium shows 64
rays to a lamp, in nodes of 16, of 4, and one by one; blocked rays are red. A triangle goes down only where it meets a
node. It needs `pip install 'antumbra[plot]'`.
"""

import matplotlib.pyplot as plt
import numpy as np

import antumbra as at

SIZE = 1280, 300
TRIANGLES = 100_000
x, lamp = 0.35, np.array([0.35, 7.0, 1.0])
scene = at.procedural("atrium", triangles=TRIANGLES)
floor = np.stack([np.full(64, x), np.full(64, 0.02), np.linspace(-13, 13, 64)], 1)
seen = at.visibility(scene, floor, at.PointLight(lamp), normals=(0, 1, 0)).seen

corners = scene.triangles().vertices + scene.origin
side = corners[..., 0] - x
cut = (side.min(1) < 0) & (side.max(1) > 0)
a, b, s, t = corners[cut], np.roll(corners[cut], -1, 1), side[cut], np.roll(side[cut], -1, 1)
crossing = s * t < 0
share = np.where(crossing, s / np.where(crossing, s - t, 1), 0)[..., None]
ends = (a + share * (b - a))[crossing & (crossing.sum(1) == 2)[:, None]].reshape(-1, 2, 3)

figure, panels = plt.subplots(1, 3, figsize=(SIZE[0] / 100, SIZE[1] / 100), layout="constrained", sharey=True)
for panel, size in zip(panels, (16, 4, 1)):
    for k in range(0, 64, size):
        z, colour = (
            floor[k : k + size, 2],
            plt.cm.tab20(k // size % 20) if size > 1 else ("#2b8a3e", "#e03131")[int(not seen[k])],
        )
        panel.fill([lamp[2], z[0] - 0.1, z[-1] + 0.1], [lamp[1], 0, 0], color=colour, alpha=0.5, linewidth=0)
    panel.plot(ends[..., 2].T, ends[..., 1].T, color="#222222", linewidth=0.6)
    panel.plot(lamp[2], lamp[1], "o", color="#f08c00", markersize=9)
    panel.set(
        title=f"{64 // size} nodes of {size} rays" if size > 1 else "64 rays",
        aspect="equal",
        xlim=(-13.5, 13.5),
        ylim=(-0.5, 8),
    )
    panel.axis("off")
figure.savefig("ray_hierarchy.png", dpi=100)
