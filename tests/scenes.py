"""Where the real scenes are, for the tests that want them; none is needed, and each absence is said aloud."""

import os
from pathlib import Path

import pytest

_BESIDE = Path(__file__).resolve().parents[2] / "shared" / "scenes"


def scene_folder() -> Path | None:
    """The folder of real scenes: $ANTUMBRA_SCENES, else ../shared/scenes beside the repository, if there."""
    folder = Path(os.environ.get("ANTUMBRA_SCENES", _BESIDE))
    return folder if folder.is_dir() else None


def scene_path(name: str) -> Path:
    """A real scene, such as "sponza_crytek/scene.glb"; skips the test where it is absent."""
    folder = scene_folder()
    if folder is None or not (folder / name).exists():
        pytest.skip(f"real scene {name} is absent: set ANTUMBRA_SCENES to the folder that has it")
    return folder / name
