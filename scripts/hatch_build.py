"""Build hook for platform wheels: compiles the kernels for common processors and adds them to the wheel.

    HATCH_BUILD_HOOK_ENABLE_CUSTOM=1 pip wheel --no-deps -w dist .

Without the variable, the wheel is pure Python, and kernels are compiled on first use. ``ANTUMBRA_PACK_LEVELS`` selects
processor levels, separated by commas; the default is all levels of this architecture.
"""

import os
import platform
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_X86 = "x86-64-v2", "x86-64-v3", "x86-64-v4"
_LEVELS = {"x86_64": _X86, "amd64": _X86, "aarch64": ["aarch64"], "arm64": ["aarch64"]}


class PackHook(BuildHookInterface):
    """Adds the packs of `antumbra.kernels.toolchain.kernel_manifest`, and tags the wheel for this system and Python."""

    def initialize(self, version, build_data):
        if version == "editable":
            return
        self._folder = tempfile.TemporaryDirectory()
        levels = os.environ.get("ANTUMBRA_PACK_LEVELS", "").replace(",", " ").split()
        levels = levels or _LEVELS.get(platform.machine().lower(), [])
        if not levels:
            raise RuntimeError(f"kernel packs are not supported on {platform.machine()}: build a pure wheel")
        chosen = [word for level in levels for word in ("--level", level)]
        environment = dict(os.environ, PYTHONPATH=str(Path(self.root) / "src"))
        command = [
            sys.executable,
            "-m",
            "antumbra.kernels.toolchain.kernel_manifest",
            "--out",
            self._folder.name,
            *chosen,
        ]
        subprocess.run(command, env=environment, check=True)
        build_data["force_include"][self._folder.name] = "antumbra/kernels/packs"
        build_data["pure_python"] = False
        build_data["tag"] = f"cp{sys.version_info[0]}{sys.version_info[1]}-none-{_system()}"

    def finalize(self, version, build_data, artifact_path):
        if hasattr(self, "_folder"):
            self._folder.cleanup()


def _system() -> str:
    """This system's platform tag. Kernels call only mathematical functions and memcpy from the C library."""
    name = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    return name.replace("linux_", "manylinux_2_17_")
