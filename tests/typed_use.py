"""The public API as a user's type checker sees it: mypy reads this file, and nobody runs it."""

from datetime import UTC, date
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import antumbra as at


def use() -> None:
    scene = at.load("model.glb", up="z")
    camera = at.Camera((0, 1, 5), (0, 0, 0), width=64, height=64)
    lights = [at.PointLight((0, 3, 0)), at.QuadLight((0, 3, 0), (1, 0, 0), (0, 0, 1), intensity=2.0)]
    frame = at.render(scene, camera, lights, spp=16, plan="bsah+multifrusta", filter=True)
    assert_type(frame, at.Frame)
    assert_type(at.render(scene, options=at.RenderOptions(spp=4), camera=camera, adaptive=16), at.Frame)
    at.render(scene, camera, lights, spp="16")  # type: ignore[arg-type]
    at.render(scene, camera, lights, sppp=16)  # type: ignore[call-arg]
    at.Renderer(scene).render(camera, lights, filter=1.5)  # type: ignore[arg-type]
    assert_type(at.RenderOptions(ground=True).cull_faces, str | None)
    assert_type(frame.image, NDArray[np.float32])
    frame.save("picture.png")
    assert_type(scene.occluded([0, 1, 0], [[0, 1, 0]], tmax=3.0), NDArray[np.bool_])
    assert_type(scene.closest_hit(np.zeros((5, 3)), np.ones((5, 3))), at.Hit)
    scene.update(np.zeros((4, 3, 3)))
    scene.update(objects=["wheel*", 2], transform=np.eye(4))
    assert_type(scene.lights, list[at.Light])
    assert_type(scene.cameras, list[at.Camera])
    assert_type(at.visibility(scene, np.zeros((4, 3)), lights[0], spp=4), at.Visibility)
    assert_type(at.Renderer(scene, "cones", threads=2).render(camera, lights), at.Frame)
    assert_type(at.Scene.from_arrays(np.zeros((3, 3)), np.array([[0, 1, 2]])), at.Scene)
    assert_type(at.build_store([at.procedural("atrium")], "scene.antumbra"), at.BuildReport)
    assert_type(at.virtual_point_lights(scene, lights[0], 64), at.PointLights)
    assert_type(at.DirectionalLight((0, -1, 0), angular_diameter=0.5).direction, np.ndarray)
    assert_type(at.bake("model.glb", "baked.glb", "light", lights=lights, spp=16), at.Baked)
    at.bake("model.glb", "baked.glb", radius="far")  # type: ignore[arg-type]
    assert_type(at.dataset(scene, "set", [camera], orbit=4, size=(64, 64)), at.Dataset)
    assert_type(at.viewshed(scene, "face", [0, 2, 0], max_distance=10.0), at.Viewshed)
    place = at.place_of(scene, latitude=52.0, longitude=4.4)
    assert place is not None
    assert_type(at.sun_hours(scene, "face", "2026-06-21", place=place, sky_view=64, by=["month"]), at.Table)
    assert_type(at.skyline(scene, (0.0, 1.0, 0.0), azimuth_step=5.0, north=1.0), at.Skyline)
    assert_type(at.shadow(scene, at="2026-06-21T15:00", place=place, per="object"), at.Shadow)
    suns = at.suns_of(place, at.times_of([date(2026, 6, 21)], UTC, 60), scene.up)
    assert_type(suns, at.Suns)
    city = at.load("city.json", lod="2.2").city
    if city is not None:
        assert_type(city, at.CityModel)
        at.write_attributes("city.json", "out.json", {"hours": np.zeros(len(city.object_of_face))})
    assert_type(at.view(scene, lights, port=0).url, str)
    assert_type(str(at.Plan(trace="single")), str)
