"""Makes one picture of the default pictures of all scenes, side by side, to judge them together.

python scripts/montage.py OUTPUT.png [--scenes FOLDER] [--only TEXT] [--size N] [--columns N] [-- OPTION ...]

The scenes are those of a folder (FOLDER/*/scene.glb and FOLDER/gltf/*; by default the folder that ANTUMBRA_SCENES
names), and the procedural ones. --only takes the scenes whose names contain TEXT. Options after -- go to antumbra
render. A scene that cannot be rendered is an empty tile, and the exit code is then 1.
"""

import argparse
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image, ImageDraw

from antumbra.cli import main as antumbra
from antumbra.generate.procedural_scenes import PROCEDURAL

GAP, BEHIND, INK = 4, (40, 40, 40), (255, 80, 60)


def scenes_in(folder: Path | None) -> dict[str, str]:
    """Name -> what antumbra render takes."""
    found = {}
    if folder is not None:
        found = {path.parent.name: str(path) for path in sorted(folder.glob("*/scene.glb"))}
        found |= {path.stem: str(path) for path in sorted(folder.glob("gltf/*.gl*"))}
    return found | {name: f"procedural:{name}" for name in PROCEDURAL}


def tile(scene: str, size: int, options: list[str]) -> Image.Image | None:
    """The default picture of a scene; None if it cannot be rendered."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        code = antumbra(["render", scene, "-o", str(path), "--size", str(size), "--quiet", *options])
        if code:
            return None
        with Image.open(path) as picture:
            return picture.convert("RGBA")


def montage(tiles: dict[str, Image.Image | None], size: int, columns: int) -> Image.Image:
    """The tiles with their names, row by row."""
    pitch, rows = size + GAP, -(-len(tiles) // columns)
    out = Image.new("RGB", (columns * pitch - GAP, rows * pitch - GAP), BEHIND)
    for i, (name, picture) in enumerate(tiles.items()):
        at = i % columns * pitch, i // columns * pitch
        if picture is not None:
            out.paste(picture, at, picture)
        ImageDraw.Draw(out).text((at[0] + 4, at[1] + 4), name, fill=INK)
    return out


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", type=Path)
    parser.add_argument("--scenes", type=Path, default=os.environ.get("ANTUMBRA_SCENES"))
    parser.add_argument("--only", default="")
    parser.add_argument("--size", type=int, default=320)
    parser.add_argument("--columns", type=int, default=6)
    end = arguments.index("--") if "--" in arguments else len(arguments)
    given, options = parser.parse_args(arguments[:end]), arguments[end + 1 :]
    scenes = {name: scene for name, scene in scenes_in(given.scenes).items() if given.only in name}
    if not scenes:
        parser.error(f"no scene's name contains {given.only!r}")
    tiles = {}
    for name, scene in scenes.items():
        print(name, flush=True)
        tiles[name] = tile(scene, given.size, options)
    montage(tiles, given.size, given.columns).save(given.output)
    return int(None in tiles.values())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
