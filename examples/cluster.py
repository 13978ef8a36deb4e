"""One job in shards, as on several machines: python examples/cluster.py [FOLDER] [--ray]

It computes hours of sun in a city ($ANTUMBRA_SCENES/delft_city, else a procedural one) in three processes, merges their
shards, and compares the result with that of a single process. With --ray, a local Ray cluster repeats the job.
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
    single, shared = folder / "whole", folder / "shared"
    done(antumbra(single, *JOB))
    done(*(antumbra(shared, *JOB, "--shard", f"{i}/{SHARDS}") for i in range(SHARDS)))
    done(antumbra(shared, "merge", "sun.shards", "--quiet"))
    compare(single, shared)
    if ray:
        done(antumbra(folder / "ray", *JOB, "--ray", "local"))
        compare(single, folder / "ray")


def compare(single: Path, other: Path) -> None:
    for path in sorted(single.iterdir()):
        same = path.read_bytes() == (other / path.name).read_bytes()
        print(f"{other.name}/{path.name}: {'the bytes of the whole' if same else 'DIFFERS'}")
        assert same


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--ray"]
    main(Path(words[0] if words else tempfile.mkdtemp()), "--ray" in sys.argv)
