"""The licence that a file of a scene states."""

import json
from pathlib import Path

_LONGEST_HEADER = 64 << 20  # bytes of the JSON of a glTF file


def licence_in(path: Path) -> str | None:
    """The licence that a glTF or CityJSON file states; None: it states none."""
    suffix = path.suffix.lower()
    try:
        if suffix == ".glb":
            with open(path, "rb") as file:
                head = file.read(20)
                size = int.from_bytes(head[12:16], "little")
                root = json.loads(file.read(size)) if size <= _LONGEST_HEADER else {}
        elif suffix in (".gltf", ".json") and path.stat().st_size <= _LONGEST_HEADER:
            root = json.loads(path.read_bytes())
        else:
            return None
    except (OSError, ValueError):
        return None
    if not isinstance(root, dict):
        return None
    asset, metadata = root.get("asset"), root.get("metadata")
    places = [asset.get("copyright")] if isinstance(asset, dict) else []
    if isinstance(metadata, dict):
        places += [metadata.get(name) for name in ("license", "licence", "datasetLicense")]
    return next((text for text in places if isinstance(text, str) and text.strip()), None)
