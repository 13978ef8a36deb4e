"""Build hook of platform wheels: it compiles the kernels for the common processors and puts them into the wheel.

    HATCH_BUILD_HOOK_ENABLE_CUSTOM=1 pip wheel --no-deps -w dist .

Without the variable the wheel is pure Python, and kernels are compiled when they are first used. The variable
``ANTUMBRA_PACK_LEVELS`` chooses levels of processors, separated by commas. The default is all levels of this kind of
machine.
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
            raise RuntimeError(f"no packs can be made on {platform.machine()}: build a pure wheel")
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
    """The name of this system in the wheel's tag. Kernels call only mathematics and memcpy of the C library."""
    name = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    return name.replace("linux_", "manylinux_2_17_")
