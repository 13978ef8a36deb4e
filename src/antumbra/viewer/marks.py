"""Marks in the page: handles of lights, and lines from a clicked point to the lights and what blocks them."""

from collections.abc import Callable
from threading import Lock
from typing import Any

import numpy as np

from .lamps import Lamp, handle, outline
from .model import Model
from .probe import Probe

_LIGHT, _SEEN, _BLOCKED, _BEYOND = (255, 196, 60), (255, 214, 64), (255, 64, 64), (150, 40, 60)
_HANDLE = 0.9  # page units: length of a handle's arrows
_POINT = 0.03  # page units: radius of a clicked point


class Marks:
    """What is drawn over the pictures.

    Parameters
    ----------
    page : Page
        Its `changed` is called after a handle was moved.
    """

    def __init__(self, page: Any):
        self._page, self._scene = page, page.server.scene
        self._model: Model = page.model
        self._handles: dict[str, Any] = {}
        self._shown, self._lock = True, Lock()
        self.refresh()

    def show_handles(self, shown: bool) -> None:
        """Show or hide the handles of all lights."""
        self._shown = shown
        self.refresh()

    def refresh(self) -> None:
        """Put the handles where the lights are."""
        with self._lock:
            for lamp in self._model.lamps:
                place = handle(lamp.light, self._model.stage)
                if place is not None:
                    self._put(lamp, place)

    def point_at(self, found: Probe | None) -> None:
        """Show what a point sees: lines to the lights, red up to what blocks them, and the blocking triangles."""
        for name in "/point", "/sights", "/blockers":
            self._scene.remove_by_name(name)
        if found is None:
            return
        to_page = self._model.stage.to_page
        self._scene.add_icosphere("/point", _POINT, color=_SEEN, position=to_page(found.position))
        lines, colours = sight_lines(found)
        if len(lines):
            self._draw("/sights", to_page(lines), colours, 2.5)
        rings = [sight.blocker.corners for sight in found.sights if sight.blocker is not None]
        if rings:
            edges = np.concatenate([np.stack([ring, np.roll(ring, -1, 0)], 1) for ring in rings])
            self._scene.add_line_segments(
                "/blockers", to_page(edges), _BLOCKED, thickness=4.0, thickness_units="screen"
            )

    def _put(self, lamp: Lamp, place: np.ndarray) -> None:
        on, path = self._shown and lamp.on, f"/lights/{lamp.name}"
        if lamp.name not in self._handles:
            handle = self._handles[lamp.name] = self._scene.add_transform_controls(
                path, scale=_HANDLE, disable_rotations=True, depth_test=False, position=place
            )
            self._scene.add_label(f"{path}/name", lamp.name)
            handle.on_update(self._page.heard(self._mover(lamp.name)))
        handle = self._handles[lamp.name]
        handle.visible = on
        if not np.allclose(handle.position, place, atol=1e-5):
            handle.position = place
        lines = outline(lamp.light, self._model.stage)
        if len(lines):
            self._scene.add_line_segments(
                f"/outlines/{lamp.name}", lines, _LIGHT, thickness=2.0, thickness_units="screen", visible=on
            )

    def _draw(self, name: str, lines: np.ndarray, colours: Any, pixels: float, visible: bool = True) -> None:
        self._scene.add_line_segments(name, lines, colours, thickness=pixels, thickness_units="screen", visible=visible)

    def _mover(self, name: str) -> Callable:
        async def moved(event: Any) -> None:
            self._model.move(name, np.array(event.target.position, np.float64))
            self._page.changed()

        return moved


def sight_lines(found: Probe) -> tuple[np.ndarray, np.ndarray]:
    """(k, 2, 3) float64, world: lines from a point to the lights; (k, 2, 3) uint8: their colours."""
    lines: list[tuple] = []
    colours = []
    for sight in found.sights:
        if sight.end is None:
            continue
        if sight.at is None:
            lines.append((found.position, sight.end))
            colours.append(_SEEN)
            continue
        lines += [(found.position, sight.at), (sight.at, sight.end)]
        colours += [_BLOCKED, _BEYOND]
    shown = np.repeat(np.array(colours, np.uint8).reshape(-1, 1, 3), 2, 1)
    return np.array(lines, np.float64).reshape(-1, 2, 3), shown
