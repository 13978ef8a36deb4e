"""Open3D's own tests of RaycastingScene, with its class and with Antumbra's.

    python benchmarks/open3d_suite.py CHECKOUT

CHECKOUT is a clone of https://github.com/isl-org/Open3D, at the tag of the installed version; its file
python/test/t/geometry/test_raycasting_scene.py runs with each class.
"""

import argparse
import sys
from pathlib import Path

import pytest

import antumbra as at
from antumbra.integrations.open3d import RaycastingScene
from comparison import start
from peers import open3d_rays

TESTS = Path("python/test/t/geometry/test_raycasting_scene.py")


class Outcomes:
    """A plugin of pytest that counts outcomes."""

    def __init__(self) -> None:
        self.passed, self.failed = 0, list[str]()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid.partition("::")[2])
        elif report.when == "call" and report.passed:
            self.passed += 1


def run_suite(tests: Path) -> Outcomes:
    """The outcomes of the tests with the class that `open3d.t.geometry` holds now."""
    outcomes = Outcomes()
    pytest.main(["-q", "-p", "no:cacheprovider", f"--rootdir={tests.parent}", str(tests)], [outcomes])
    return outcomes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", type=Path, help="a clone of Open3D's repository")
    tests = parser.parse_args().checkout / TESTS
    if not tests.is_file():
        raise at.InputError(f"{tests} does not exist; clone https://github.com/isl-org/Open3D")
    geometry, results = open3d_rays.library().t.geometry, dict[str, Outcomes]()
    for name, scene in (("Open3D", geometry.RaycastingScene), ("Antumbra", RaycastingScene)):
        geometry.RaycastingScene = scene
        results[name] = run_suite(tests)
    for name, outcomes in results.items():
        n = outcomes.passed + len(outcomes.failed)
        print(f"{name:10} {outcomes.passed} of {n} tests pass{''.join(f'; fails: {each}' for each in outcomes.failed)}")


if __name__ == "__main__":
    sys.exit(start(main))
