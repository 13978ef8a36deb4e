"""The npm package of `scripts/release`: built, given its types, packed, and tried by its own example."""

import gzip
import io
import json
import re
import shutil
import sys
import tarfile
from pathlib import Path

from release_build import ReleaseError, Source, environment_of, run

TYPESCRIPT = "typescript@6"


def build_javascript(source: Source, work: Path) -> Path:
    """Build the package for npm from a source, and return its archive. Raises ReleaseError without node."""
    if shutil.which("npx") is None:
        raise ReleaseError("node is not installed, and the package for JavaScript needs it for its types and its trial")
    folder = work / "javascript"
    env = environment_of(source, PYTHONPATH=str(source.root / "src"))
    run(
        [sys.executable, "-m", "antumbra.web.javascript_package", "--out", folder],
        "the package for JavaScript",
        env=env,
    )
    types = ["npx", "--yes", "-p", TYPESCRIPT, "tsc", "--outDir", folder]
    run(types, "the types for JavaScript", source.root)
    shutil.copyfile(source.root / "LICENSE", folder / "LICENSE")
    return pack(folder, work, source.epoch)


def pack(folder: Path, out: Path, epoch: int) -> Path:
    """Write a folder as npm's archive, with the same bytes each time, and return its path."""
    about = json.loads((folder / "package.json").read_text())
    path = out / f"{about['name']}-{about['version']}.tgz"
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for file in sorted(each for each in folder.rglob("*") if each.is_file()):
            info = tarfile.TarInfo(f"package/{file.relative_to(folder).as_posix()}")
            info.size, info.mtime, info.mode = file.stat().st_size, epoch, 0o644
            archive.addfile(info, io.BytesIO(file.read_bytes()))
    path.write_bytes(gzip.compress(data.getvalue(), mtime=epoch))
    return path


def try_javascript(archive: Path, source: Source, work: Path) -> None:
    """Install the archive into an empty folder, and run the example of its page."""
    folder = work / "javascript-trial"
    folder.mkdir()
    (folder / "package.json").write_text('{"type": "module"}')
    run(["npm", "install", "--no-audit", "--no-fund", archive], "npm install", folder)
    page = (source.root / "src" / "antumbra" / "web" / "module" / "README.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```js\n(.*?)```", page, re.S)
    (folder / "example.js").write_text(example)
    run(["node", "example.js"], "the example of the package for JavaScript", folder)
