"""Makes the files of this folder with the tools of the web: python make.py, after npm install gltfpack ktx2-encoder.

The plain scene is `web_scene.garden`; each file stores it with other options of gltfpack. The images
hold `web_scene.leaf`, in the two codecs of Basis Universal.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER.parents[1] / "support"))

from web_scene import PACKED, garden, leaf  # noqa: E402

ENCODE = """
import { encodeToKTX2 } from "ktx2-encoder";
import { readFileSync, writeFileSync } from "node:fs";
const { input, output, width, height, ...options } = JSON.parse(process.argv[1]);
const pixels = new Uint8Array(readFileSync(input));
const imageDecoder = async () => ({ data: pixels, width, height });
writeFileSync(output, await encodeToKTX2(pixels, { imageDecoder, isKTX2File: true, ...options }));
"""
IMAGES = {
    "leaf-etc1s.ktx2": {"isUASTC": False, "generateMipmap": True, "qualityLevel": 255, "compressionLevel": 5},
    "leaf-uastc.ktx2": {"isUASTC": True, "generateMipmap": False, "needSupercompression": True},
    "opaque-etc1s.ktx2": {"isUASTC": False, "generateMipmap": False, "qualityLevel": 255},
}


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        for file, options in PACKED.items():
            plain = garden(at_rest="-mi" in options).write(Path(name), "plain.glb")
            subprocess.run(["npx", "gltfpack", "-i", plain, "-o", FOLDER / file, *options], check=True)
        for file, options in IMAGES.items():
            pixels = leaf(opaque=file.startswith("opaque"))
            raw = Path(name) / "pixels"
            raw.write_bytes(pixels.tobytes())
            height, width = pixels.shape[:2]
            case = {"input": str(raw), "output": str(FOLDER / file), "width": width, "height": height, **options}
            subprocess.run(["node", "--input-type=module", "-e", ENCODE, json.dumps(case)], check=True)


if __name__ == "__main__":
    main()
