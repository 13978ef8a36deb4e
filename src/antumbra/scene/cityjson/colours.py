"""Pale colours of semantic surfaces and of city objects."""

import numpy as np

from ..colour import srgb_to_linear

SURFACES = {
    "RoofSurface": "#d9a08b",
    "WallSurface": "#ece3d4",
    "GroundSurface": "#c9c2b6",
    "ClosureSurface": "#dcd8d0",
    "OuterCeilingSurface": "#d5cdc0",
    "OuterFloorSurface": "#cfc7ba",
    "Window": "#a9c3d4",
    "Door": "#b99f86",
    "WaterSurface": "#a3c4dc",
    "WaterGroundSurface": "#b9b3a2",
    "WaterClosureSurface": "#b6cfdf",
    "TrafficArea": "#b8b8bb",
    "AuxiliaryTrafficArea": "#c6c9b4",
    "TransportationMarking": "#e6e6e6",
    "TransportationHole": "#8f8f92",
}
"""Type of a semantic surface -> sRGB."""

OBJECTS = {
    "Building": "#ece3d4",
    "Bridge": "#cfcac4",
    "Tunnel": "#bdb8b2",
    "OtherConstruction": "#d6cfc6",
    "Road": "#b8b8bb",
    "Railway": "#b5aaa0",
    "Waterway": "#a3c4dc",
    "TransportSquare": "#c4c1bd",
    "TransportationSquare": "#c4c1bd",
    "WaterBody": "#a3c4dc",
    "LandUse": "#d3d8bb",
    "PlantCover": "#b4cc9b",
    "SolitaryVegetationObject": "#9fbf86",
    "TINRelief": "#d6cfb6",
    "CityFurniture": "#c7b7a6",
}
"""Type of a city object, or its beginning -> sRGB."""

OTHERS = "#dddad5"


def colours_of(surface_types: list[str | None], object_types: list[str]) -> np.ndarray:
    """Linear colours, (n, 3) float32, of surfaces with the objects that own them."""
    known: dict[tuple[str | None, str], int] = {}
    places = [known.setdefault(pair, len(known)) for pair in zip(surface_types, object_types)]
    table = np.array([_linear(_hex(*pair)) for pair in known], np.float32).reshape(-1, 3)
    return table[places]


def _hex(surface: str | None, thing: str) -> str:
    if surface in SURFACES:
        return SURFACES[surface]
    if thing in OBJECTS:
        return OBJECTS[thing]
    return next((colour for begin, colour in OBJECTS.items() if thing.startswith(begin)), OTHERS)  # BuildingPart


def _linear(colour: str) -> np.ndarray:
    return srgb_to_linear([int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])
