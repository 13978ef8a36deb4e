"""Start-up and whole-command times: `import antumbra`, and `antumbra render` of the default scene with cached kernels.

python benchmarks/startup.py [--rounds N] [--json FILE]
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path


def seconds(command: list[str], rounds: int) -> list[float]:
    """Wall time of each of `rounds` runs; the first, which may compile, is made before and not counted."""
    subprocess.run(command, check=True, capture_output=True)
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        picture = str(Path(folder) / "antumbra.png")
        commands = {
            "python -c pass": [sys.executable, "-c", "pass"],
            "import antumbra": [sys.executable, "-c", "import antumbra"],
            "antumbra --help": [sys.executable, "-m", "antumbra", "--help"],
            "antumbra render": [sys.executable, "-m", "antumbra", "render", "-o", picture],
        }
        rows = {name: seconds(command, options.rounds) for name, command in commands.items()}
    for name, times in rows.items():
        print(f"{name:18} median {statistics.median(times):6.2f} s   best {min(times):6.2f} s   of {len(times)}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
