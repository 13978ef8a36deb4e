"""Documents of a release: checksums, notes, the bill of materials, and the recipe for conda-forge."""

import hashlib
import json
import re
import sys
from pathlib import Path

from release_build import ROOT, ReleaseError, Source, run


def checksums(paths: list[Path]) -> str:
    """Lines for ``sha256sum --check``, by name."""
    names = sorted(paths, key=lambda path: path.name)
    return "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in names)


def release_notes(changelog: str, version: str) -> str:
    """The section of a version in the changelog, without its heading. Raises ReleaseError if it has none."""
    sections = re.split(r"^## (.+)\n", changelog, flags=re.MULTILINE)
    for heading, text in zip(sections[1::2], sections[2::2]):
        if heading.split()[0] == version and text.strip():
            return text.strip() + "\n"
    raise ReleaseError(f"CHANGELOG.md has no section about {version}; write one under '## {version}'")


def bill_of_materials(source: Source, python: Path, out: Path) -> None:
    """Write the CycloneDX bill of materials of an environment in which the package is installed."""
    command = [sys.executable, "-m", "cyclonedx_py", "environment", "--output-reproducible", "--of", "JSON"]
    run([*command, "-o", out, python], "cyclonedx-py")
    bill = json.loads(out.read_text(encoding="utf-8"))
    if source.version not in [each.get("version") for each in bill["components"] if each["name"] == "antumbra"]:
        raise ReleaseError(f"{out.name}: does not name antumbra {source.version}")


def conda_recipe(template: str, version: str, sha256: str) -> str:
    """The recipe of `recipe/recipe.yaml` for a version and the digest of its sdist."""
    for name, value in (("version", version), ("sha256", sha256)):
        template, n = re.subn(rf'^(  {name}: )"[^"]*".*$', rf'\g<1>"{value}"', template, flags=re.MULTILINE)
        if n != 1:
            raise ReleaseError(f"recipe/recipe.yaml: has {n} lines for the {name} in its context, not one")
    return template


def write_documents(source: Source, paths: list[Path], python: Path, out: Path) -> list[Path]:
    """Write all documents of packages into a folder, and return their paths.

    python : interpreter of an environment with the installed wheel
    """
    (sdist,) = [path for path in paths if path.suffix == ".gz"]
    notes = release_notes((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), source.version)
    recipe = (ROOT / "recipe" / "recipe.yaml").read_text(encoding="utf-8")
    texts = {
        "release-notes.md": notes,
        "recipe.yaml": conda_recipe(recipe, source.version, hashlib.sha256(sdist.read_bytes()).hexdigest()),
    }
    for name, text in texts.items():
        (out / name).write_text(text, encoding="utf-8")
    bill = out / f"antumbra-{source.version}.cdx.json"
    bill_of_materials(source, python, bill)
    documents = [*(out / name for name in texts), bill]
    (out / "SHA256SUMS").write_text(checksums([*paths, *documents]), encoding="utf-8")
    return [*documents, out / "SHA256SUMS"]
