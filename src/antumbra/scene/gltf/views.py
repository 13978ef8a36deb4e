"""Cameras and KHR_lights_punctual lights, placed by nodes."""

import numpy as np

from ...errors import InputError
from ..camera import Camera
from ..lights import DirectionalLight, Light, PointLight
from .fields import Fields
from .nodes import Nodes

HEIGHT = 1024  # pixels of a camera's picture; glTF gives only the aspect ratio
EXTENSION = "KHR_lights_punctual"


class Views:
    """The cameras and the lights of a file's scene, in the order of their nodes."""

    def __init__(self, root: Fields, nodes: Nodes):
        self.notes: list[str] = []
        self._nodes = nodes
        self._cameras = self._placed_cameras(root)
        self._lights = self._placed_lights(root)

    def holders(self) -> list[int]:
        """Nodes that hold a camera or light."""
        return [node for node, _ in self._cameras] + [node for node, *_ in self._lights]

    def cameras(self, world: np.ndarray) -> list[Camera]:
        """The cameras, which look along -Z of their nodes; `world` has the nodes' world matrices."""
        cameras = []
        for node, lens in self._cameras:
            position, up, backward = (
                world[node][:3, 3],
                self._axis(world, node, 1),
                self._axis(world, node, 2),
            )
            cameras.append(Camera(position, position - backward, up, height=HEIGHT, **lens))
        return cameras

    def lights(self, world: np.ndarray) -> list[Light]:
        """The lights. Directional lights shine along -Z of their nodes."""
        lights: list[Light] = []
        for node, kind, intensity, colour, name in self._lights:
            light: Light
            if kind == "directional":
                direction = -self._axis(world, node, 2)
                light = DirectionalLight(direction=direction, intensity=intensity, colour=colour)
            else:
                light = PointLight(position=world[node][:3, 3], intensity=intensity, colour=colour)
            lights.append(light.named(name))
        return lights

    def _axis(self, world: np.ndarray, node: int, column: int) -> np.ndarray:
        axis = world[node][:3, column]
        length = np.linalg.norm(axis)
        if not 0.0 < length < np.inf:
            raise InputError(f"{self._nodes.fields[node].where} holds a camera or light but its transform is flat")
        return axis / length

    def _placed_cameras(self, root: Fields) -> list[tuple[int, dict]]:
        cameras, placed = root.objects("cameras"), []
        for node in np.flatnonzero(self._nodes.visible).tolist():
            index = self._nodes.fields[node].whole("camera", None, high=len(cameras))
            if index is None:
                continue
            perspective, flat = cameras[index].object("perspective"), cameras[index].object("orthographic")
            if perspective is not None:
                placed.append((node, _perspective(perspective)))
            elif flat is not None:
                placed.append((node, _orthographic(flat)))
            else:
                self.notes.append(f"{cameras[index].where} is neither perspective nor orthographic; left out")
        return placed

    def _placed_lights(self, root: Fields) -> list[tuple[int, str, float, tuple, str]]:
        extension = root.extension(EXTENSION)
        lights, placed = [] if extension is None else extension.objects("lights"), []
        for node in np.flatnonzero(self._nodes.visible).tolist():
            reference = self._nodes.fields[node].extension(EXTENSION)
            if reference is None:
                continue
            light = lights[reference.whole("light", high=len(lights))]
            kind, intensity = light.text("type"), light.number("intensity", 1.0)
            if kind not in ("point", "directional", "spot"):
                raise light.bad("type", "point, directional or spot")
            if intensity < 0.0:
                raise light.bad("intensity", "0 or more")
            if kind == "spot":
                self.notes.append(f"{light.where} is a spot light; taken as a point light that shines all around")
            colour = tuple(np.maximum(light.numbers("color", 3, np.ones(3)), 0.0).tolist())
            name = light.text("name", "") or self._nodes.fields[node].text("name", "")
            placed.append((node, kind, intensity, colour, name))
        return placed


def _perspective(lens: Fields) -> dict:
    """The arguments of a perspective `Camera`."""
    vfov, aspect = np.degrees(lens.number("yfov")), lens.number("aspectRatio", 1.0)
    if not 0.0 < vfov < 180.0:
        raise lens.bad("yfov", "an angle between 0 and pi radians")
    if not 1.0 / HEIGHT <= aspect <= 32.0:
        raise lens.bad("aspectRatio", f"between 1/{HEIGHT} and 32")
    return {"vfov": float(vfov), "width": round(HEIGHT * aspect)}


def _orthographic(lens: Fields) -> dict:
    """The arguments of an orthographic `Camera`. Like those of perspective cameras, its clipping planes are ignored."""
    across, above = abs(lens.number("xmag")), abs(lens.number("ymag"))  # half the width and half the height
    if not 0.0 < above < np.inf:
        raise lens.bad("ymag", "a number other than 0")
    if not 1.0 / HEIGHT <= across / above <= 32.0:
        raise lens.bad("xmag", f"between 1/{HEIGHT} and 32 times ymag")
    return {"projection": "orthographic", "extent": 2.0 * above, "width": round(HEIGHT * across / above)}
