"""Generates the pictures of the docs by running the programs of docs/gallery/ and examples/.

    python scripts/gallery.py [--only NAME ...] [--quick] [--thumbnails] [--output FOLDER]

A program of docs/gallery/ writes NAME.png into the current folder, which becomes docs/images/gallery/NAME.webp and its
thumbnail small/NAME.webp; or NAME.webp, a film, which is kept as it is. The picture and the output of examples/NAME.py
go to docs/images/examples/.

Real scenes come from the folder $ANTUMBRA_SCENES. Without it, programs that need them are skipped with a message, and
keep their old pictures. --quick makes tiny pictures, as the tests do; --thumbnails makes only thumbnails, of the
pictures in FOLDER, which replaces docs/images.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from snippets import run_shell

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS, EXAMPLES = ROOT / "docs" / "gallery", ROOT / "examples"
IMAGES = ROOT / "docs" / "images"
THUMBNAIL = 400, 250  # pixels
WIDEST = 1280  # pixels of a picture

PARTS = {
    "comparison": (0.0, 0.0, 0.5, 0.983),
    "culling": (0.0, 0.12, 0.333, 0.744),
    "dataset": (0.0, 0.0, 1.0, 1.0),
    "day": (0.0, 0.5, 0.5, 1.0),
    "heat_map": (0.0, 0.0, 1.0, 1.0),
    "hills_view": (0.0, 0.0, 1.0, 1.0),
    "horizon": (0.1, 0.1, 0.67, 0.87),
    "light_sizes": (0.0, 0.0, 1.0, 1.0),
    "map_sheet": (0.154, 0.22, 0.612, 0.625),
    "penumbra_filter": (0.0, 0.0, 1.0, 1.0),
    "ray_hierarchy": (0.333, 0.0, 0.667, 1.0),
    "shadow_map": (0.1, 0.19, 0.68, 0.703),
    "sun_hours": (0.0, 0.0, 1.0, 1.0),
}
"""What thumbnails of charts, sheets and series show: left, upper, right and lower edge, as fractions of the picture."""

CREDITS = {
    "delft_city": "Model: a part of Delft, by 3dfier of TU Delft, from the open data BGT and AHN.",
    "sanmiguel_lite": "Model: a part of San Miguel by Guillermo M. Leal Llaguno, CC-BY 3.0.",
}
"""File names of real scenes in programs, with the credits that their licences require."""

CURES = {
    "delft_city": "It is `tests/data/delft.json` of [cjio](https://github.com/cityjson/cjio), triangulated. Without it,"
    " study a village, `antumbra sun example:village --days 2026-03-21 --step 15 --sensors grid:1 -o sun_hours.png`, "
    "or buildings from [3DBAG](https://3dbag.nl).",
    "sanmiguel_lite": "It is the folder `sanmiguel` of [pbrt-scenes](https://github.com/AndiMiko/pbrt-scenes), as glTF "
    'with +Z up. Without it, load another courtyard, `scene = at.procedural("atrium")`, and take its camera, `camera = '
    "scene.cameras[0].resized(*SIZE)`.",
}
"""Where these scenes come from, and what to do without them."""

_QUICK = {
    r"^SIZE = .*$": "SIZE = 48, 32",
    r"^(SPP|BOUNCE) = .*$": r"\1 = 4",
    r"^TRIANGLES = .*$": "TRIANGLES = 5_000",
    r"--size \d+x\d+": "--size 48x32",
    r"--bounce \d+": "--bounce 4",
    r"--preset final": "--preset draft",
    r"\?triangles=\d\w*": "?triangles=5k",
    r"grid:[\d.]+": "grid:20",
}
"""Patterns in programs, and their replacements for --quick."""

_CALLS = {
    r"at\.procedural\(\"": "procedural:",
    r"at\.examples\.file_of\(\"": "example:",
    r"at\.examples\.(?=\w+\()": "example:",
    r"antumbra scenes (?=[a-z])": "procedural:",
    r"antumbra render (?=-)": "procedural:atrium ",
}
"""Calls and commands that load scenes of the package, and the beginnings of the names of these."""


class Program(NamedTuple):
    """A program of docs/gallery/ or examples/."""

    path: Path
    title: str
    caption: str
    code: str  # without the title and the caption
    scenes: list[str]  # names in CREDITS that it loads

    @property
    def name(self) -> str:
        return self.path.stem

    @property
    def place(self) -> str:
        """The path in the repository."""
        return self.path.relative_to(ROOT).as_posix()

    @property
    def picture(self) -> Path:
        return IMAGES / self.path.parent.name / f"{self.name}.webp"

    @property
    def thumbnail(self) -> Path:
        return self.picture.parent / "small" / self.picture.name

    @property
    def printed(self) -> Path:
        return self.picture.with_suffix(".txt")


def programs() -> list[Program]:
    """The programs of docs/gallery/, by name."""
    return [program_of(path) for path in sorted(PROGRAMS.iterdir()) if path.suffix in (".py", ".sh")]


def examples() -> list[Program]:
    """The programs of examples/, by name. Their title ends with the command that runs them."""
    documented = [program_of(path) for path in sorted(EXAMPLES.glob("*.py"))]
    return [each._replace(title=re.sub(r"[:.] python examples/.*", "", each.title)) for each in documented]


def program_of(path: Path) -> Program:
    """A program, parted into title, caption and code."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        _, about, code = text.split('"""', 2)
    else:
        head = re.match(r"(#.*\n)+", text)[0]
        about, code = re.sub(r"^# ?", "", head, flags=re.MULTILINE), text[len(head) :]
    title, _, caption = about.strip().partition("\n")
    scenes = [name for name in CREDITS if re.search(rf"\b{name}\.glb\b", code)]
    return Program(path, title, " ".join(caption.split()), code.strip() + "\n", scenes)


def scene_file(name: str) -> Path | None:
    """The file of a real scene; None if it is not on this machine."""
    folder = Path(os.environ.get("ANTUMBRA_SCENES", "nowhere"))
    files = folder / name / "scene.glb", folder / "gltf" / f"{name}.glb"
    return next((file.resolve() for file in files if file.is_file()), None)


def packaged_scenes(program: Program) -> list[str]:
    """The scenes of the package that a program uses, such as procedural:city."""
    code = program.code
    for call, scene in _CALLS.items():
        code = re.sub(call, scene, code)
    return list(dict.fromkeys(re.findall(r"\b(?:procedural|example):\w+", code)))


def missing(program: Program) -> list[str]:
    """The real scenes that a program needs but this machine does not have."""
    return [name for name in program.scenes if scene_file(name) is None]


def draw(program: Program, folder: Path, quick: bool = False) -> Path:
    """Run a program of docs/gallery/ in a folder; return the picture that it writes there."""
    for name in program.scenes:
        (folder / f"{name}.glb").symlink_to(scene_file(name))
    text = program.path.read_text(encoding="utf-8")
    text = quick_version(text) if quick else text
    if program.path.suffix == ".sh":
        run_shell(text, folder, stdout=subprocess.DEVNULL)
    else:
        _run_python(text, program.path, folder)
    film = folder / f"{program.name}.webp"
    return film if film.exists() else film.with_suffix(".png")


def quick_version(text: str) -> str:
    """A program with a tiny picture, few rays and few triangles."""
    for pattern, value in _QUICK.items():
        text = re.sub(pattern, value, text, flags=re.MULTILINE)
    return text


def _run_python(text: str, path: Path, folder: Path) -> None:
    before = os.getcwd()
    os.chdir(folder)
    try:
        exec(compile(text, str(path), "exec"), {"__name__": "__main__"})
    finally:
        os.chdir(before)


def run_example(program: Program, folder: Path) -> tuple[str, Path | None]:
    """Run a program of examples/; return its output and the first picture that it writes."""
    command = [sys.executable, program.path, folder]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=folder)
    return done.stdout.replace(str(folder), "FOLDER"), next(iter(sorted(folder.glob("*.png"))), None)


def keep(picture: Path, target: Path, thumbnail: Path | None = None) -> None:
    """Write a picture as WebP, and its thumbnail."""
    from PIL import Image

    image = Image.open(picture).convert("RGB")
    image.thumbnail((WIDEST, 4 * WIDEST), Image.Resampling.LANCZOS)
    target.parent.mkdir(parents=True, exist_ok=True)
    if picture.suffix == target.suffix:
        shutil.copyfile(picture, target)
    else:
        image.save(target, quality=82, method=6)
    if thumbnail is not None:
        keep_thumbnail(target, thumbnail)


def keep_thumbnail(picture: Path, thumbnail: Path) -> None:
    """Write a thumbnail: the middle of a picture, or all of its part in `PARTS`; of a film, the frame in the middle."""
    from PIL import Image, ImageOps

    image = Image.open(picture)
    image.seek(getattr(image, "n_frames", 1) // 2)
    shown = image.convert("RGB")
    if picture.stem in PARTS:
        left, upper, right, lower = PARTS[picture.stem]
        edges = left * shown.width, upper * shown.height, right * shown.width, lower * shown.height
        part = shown.crop(tuple(map(round, edges)))
        small = ImageOps.pad(part, THUMBNAIL, Image.Resampling.LANCZOS, color=shown.getpixel((0, 0)))
    else:
        small = ImageOps.fit(shown, THUMBNAIL, Image.Resampling.LANCZOS)
    thumbnail.parent.mkdir(parents=True, exist_ok=True)
    small.save(thumbnail, quality=78, method=6)


def make(program: Program, quick: bool, output: Path) -> None:
    """Run a program and store its results."""
    target, thumbnail = (output / path.relative_to(IMAGES) for path in (program.picture, program.thumbnail))
    with tempfile.TemporaryDirectory() as folder:
        if program.path.parent == PROGRAMS:
            keep(draw(program, Path(folder), quick), target, thumbnail)
            return
        printed, picture = run_example(program, Path(folder))
        target.parent.mkdir(parents=True, exist_ok=True)
        target.with_suffix(".txt").write_text(printed, encoding="utf-8")
        if picture is not None:
            keep(picture, target)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--only", nargs="+", metavar="NAME", help="soft_shadows, examples/minimal.py, ...; default: all"
    )
    parser.add_argument("--quick", action="store_true", help="tiny pictures")
    parser.add_argument("--thumbnails", action="store_true", help="only thumbnails, of the pictures in FOLDER")
    parser.add_argument("--output", type=Path, default=IMAGES, metavar="FOLDER")
    options = parser.parse_args()
    known = {each.name: each for each in programs()} | {each.place: each for each in examples()}
    if unknown := set(options.only or ()) - set(known):
        parser.error(f"no program {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    for name in options.only or known:
        if options.thumbnails:
            if known[name].path.parent == PROGRAMS:
                kept = (
                    options.output / path.relative_to(IMAGES) for path in (known[name].picture, known[name].thumbnail)
                )
                keep_thumbnail(*kept)
            continue
        if lacking := missing(known[name]):
            lacks = ", ".join(lacking)
            print(f"{name}: SKIPPED, {lacks} is not in ANTUMBRA_SCENES; its old picture stays", file=sys.stderr)
            continue
        start = time.perf_counter()
        make(known[name], options.quick, options.output)
        print(f"{name}: {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
