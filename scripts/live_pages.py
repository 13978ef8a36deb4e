"""Pages with exact shadows in the docs, of generated scenes: python scripts/live_pages.py NAME OUTPUT.html

The directive ``{live}`` (docs/_ext/live.py) makes them when the site is built. Requires antumbra[sun,build].
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import antumbra as at

PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
SPRING = "2026-03-21"
_CREDITS = f"Scene and page made with Antumbra {at.__version__}"


def _camera(eye: tuple[float, ...], target: tuple[float, ...], vfov: float) -> at.Camera:
    return at.Camera(eye, target, vfov=vfov)


def _city_view() -> at.Camera:
    return _camera((125.0, 102.0, 133.0), (0.0, -4.0, 0.0), 36.0)


def city(path: Path) -> None:
    """The shadows of a city, which are long in the morning."""
    scene = at.procedural("city", triangles=50_000)
    scene.page(
        path,
        title="Shadows of a city, 21 March",
        when=f"{SPRING}T07:45",
        place=PLACE,
        camera=_city_view(),
        credits=_CREDITS,
    )


def village(path: Path) -> None:
    """The example village, as by the command of the page about pages."""
    scene = at.examples.village()
    place = at.place_of(scene, timezone="Europe/Amsterdam")
    scene.page(path, when=f"{SPRING}T16:30", place=place, credits=_CREDITS)


def hours(path: Path) -> None:
    """Hours of sun on all surfaces of a village, as by the command of the page of sun hours."""
    table = at.sun_hours(at.examples.village(), "grid:1", SPRING, step=15)
    table.page(path, title="Hours of sun on 21 March", when=f"{SPRING}T15:30", credits=_CREDITS)


def courtyard(path: Path) -> None:
    """The baked share of the sky in a courtyard."""
    with tempfile.TemporaryDirectory() as folder:
        baked = at.bake(at.procedural("atrium", triangles=20_000), Path(folder, "courtyard.glb"), spp=256)
    view = _camera((2.0, 2.4, 6.5), (0.0, 2.6, 0.0), 75.0)
    baked.page(
        path, title="How much sky a courtyard sees", when="2026-06-21T13:00", place=PLACE, camera=view, credits=_CREDITS
    )


PAGES: dict[str, Callable[[Path], None]] = {"city": city, "village": village, "hours": hours, "courtyard": courtyard}


def write(name: str, path: Path) -> None:
    """Write a page."""
    path.parent.mkdir(parents=True, exist_ok=True)
    PAGES[name](path)


if __name__ == "__main__":
    write(sys.argv[1], Path(sys.argv[2]))
