"""A cut-out for a page

`background=False` and an alpha channel: the picture goes onto any page, with smooth edges.
"""

from PIL import Image

import antumbra as at

SIZE = 900, 900
SPP = 16
scene = at.examples.mill()
frame = at.render(scene, scene.default_camera(*SIZE), spp=SPP, adaptive=SPP, background=False)
frame.save("mill.png", background="transparent")

mill = Image.open("mill.png")
page = Image.linear_gradient("L").resize((1280, SIZE[1]))
page = Image.merge(
    "RGB", [page.point(lambda v, a=a, b=b: a + (b - a) * v // 255) for a, b in [(38, 236), (70, 120), (130, 90)]]
)
page.paste(mill, ((1280 - SIZE[0]) // 2, 0), mill)
page.save("transparent.png")
