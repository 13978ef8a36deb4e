"""One job in shards, as several machines would do it: python examples/cluster.py [FOLDER] [--ray]

It measures hours of sun in a city ($ANTUMBRA_SCENES/delft_city, else a procedural one) in three processes, merges
their shards, and compares the file with that of one process. With --ray, a Ray cluster of this machine does it again.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

SHARDS = 3
CITY = Path(os.environ.get("ANTUMBRA_SCENES", "")) / "delft_city" / "scene.glb"
REAL = "ANTUMBRA_SCENES" in os.environ and CITY.exists()
SCENE = [str(CITY), "--up", "z"] if REAL else ["procedural:city?triangles=20k"]
JOB = ["sun", *SCENE, "--latitude", "52.0", "--longitude", "4.36", "--days", "2026-03-21", "--sensors", "raster:4"]
JOB += ["-o", "sun.csv", "-o", "sun.png", "--quiet"]


def antumbra(folder: Path, *words: str) -> subprocess.Popen:
    """Start the command in a folder."""
    folder.mkdir(exist_ok=True)
    return subprocess.Popen([sys.executable, "-m", "antumbra", *words], cwd=folder)


def done(*processes: subprocess.Popen) -> None:
    """Wait for processes, which must succeed."""
    for process in processes:
        if process.wait() != 0:
            sys.exit("a process failed")


def main(folder: Path, ray: bool) -> None:
    whole, shared = folder / "whole", folder / "shared"
    done(antumbra(whole, *JOB))
    done(*(antumbra(shared, *JOB, "--shard", f"{i}/{SHARDS}") for i in range(SHARDS)))
    done(antumbra(shared, "merge", "sun.shards", "--quiet"))
    compare(whole, shared)
    if ray:
        done(antumbra(folder / "ray", *JOB, "--ray", "local"))
        compare(whole, folder / "ray")


def compare(whole: Path, other: Path) -> None:
    for path in sorted(whole.iterdir()):
        same = path.read_bytes() == (other / path.name).read_bytes()
        print(f"{other.name}/{path.name}: {'the bytes of the whole' if same else 'DIFFERS'}")
        assert same


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--ray"]
    main(Path(words[0] if words else tempfile.mkdtemp()), "--ray" in sys.argv)
