"""Paths of the real scenes. Tests that use a missing scene are skipped, and the reason is shown."""

import os
from pathlib import Path

import pytest

_BESIDE = Path(__file__).resolve().parents[3] / "shared" / "scenes"


def scene_folder() -> Path | None:
    """The folder of real scenes: $ANTUMBRA_SCENES, or ../shared/scenes beside the repository; None if it is missing."""
    folder = Path(os.environ.get("ANTUMBRA_SCENES", _BESIDE))
    return folder if folder.is_dir() else None


def scene_path(name: str) -> Path:
    """The path of a real scene, such as "sponza_crytek/scene.glb". Skips the test if it is missing."""
    folder = scene_folder()
    if folder is None or not (folder / name).exists():
        pytest.skip(f"real scene {name} is absent: set ANTUMBRA_SCENES to the folder that has it")
    return folder / name
