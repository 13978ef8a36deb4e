"""Build hook for platform wheels: compiles all kernels and adds them as shared libraries, and the module of pages.

    HATCH_BUILD_HOOK_ENABLE_CUSTOM=1 pip wheel --no-deps -w dist .

Without the variable, the wheel is pure Python, and needs the extra `jit` to compile kernels on first use. A platform
wheel is for every Python from 3.11 on. ``ANTUMBRA_SYSTEM`` selects another system, such as linux-aarch64 or
windows-x86_64: every machine can build the wheels of all systems. ``ANTUMBRA_LEVELS`` selects processor levels,
separated by commas; the default is all levels of the system.
"""

import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

TAGS = {
    "linux-x86_64": "manylinux_2_17_x86_64",
    "linux-aarch64": "manylinux_2_17_aarch64",
    "macos-x86_64": "macosx_11_0_x86_64",
    "macos-arm64": "macosx_11_0_arm64",
    "windows-x86_64": "win_amd64",
    "windows-arm64": "win_arm64",
}
"""Systems, and the platform tags of their wheels."""


class LibraryHook(BuildHookInterface):
    """Adds the libraries of `antumbra.kernels.toolchain.library_build` and the module of `antumbra.web.kernel_linking`.

    It tags the wheel for the system of the libraries.
    """

    def initialize(self, version, build_data):
        if version == "editable":
            return
        system = os.environ.get("ANTUMBRA_SYSTEM") or this_system()
        if system not in TAGS:
            raise RuntimeError(f"there are no kernel libraries for {system}; choose {', '.join(TAGS)}")
        self._folder = tempfile.TemporaryDirectory()
        levels = os.environ.get("ANTUMBRA_LEVELS", "").replace(",", " ").split()
        words = ["--system", system, *(word for level in levels for word in ("--level", level))]
        for module, options, place in [
            ("kernels.toolchain.library_build", words, "kernels/libraries"),
            ("web.kernel_linking", [], "web/kernels"),
        ]:
            folder = Path(self._folder.name, place)
            command = [sys.executable, "-m", f"antumbra.{module}", *options, "--out", str(folder)]
            subprocess.run(command, env=dict(os.environ, PYTHONPATH=str(Path(self.root) / "src")), check=True)
            build_data["force_include"][str(folder)] = f"antumbra/{place}"
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{TAGS[system]}"

    def finalize(self, version, build_data, artifact_path):
        if hasattr(self, "_folder"):
            self._folder.cleanup()


def this_system() -> str:
    """The name of this machine's system; it may be one without libraries."""
    name = {"darwin": "macos", "win32": "windows"}.get(sys.platform, sys.platform)
    machine = platform.machine().lower()
    arm = "aarch64" if name == "linux" else "arm64"
    return f"{name}-{ {'amd64': 'x86_64', 'aarch64': arm, 'arm64': arm}.get(machine, machine) }"
