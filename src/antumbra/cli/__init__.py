"""The command line, ``antumbra``: one module per group of commands.

- `app`: the program and its commands; `command_help`: their help; `command_parsing`: how their words are parsed;
  `completion`: what the shell completes
- `render_command`: ``antumbra render``; `picture_spec`: its arguments and the picture they specify; `picture_report`:
  summaries and HTML pages of rendered pictures
- `bake_command`: ``antumbra bake``, light and occlusion baked into glTF files
- `view_command`: ``antumbra view``, a scene in the browser
- `study_run`: what the commands of all studies share; each declares the rest
- `shards`: the options --shard and --ray, and ``antumbra merge``
- `scene_commands`: ``antumbra info``, ``scenes`` and ``formats``
- `build_command`: ``antumbra build``
- `installation_commands`: ``antumbra doctor``, ``warmup`` and ``plans``
- `vegetation_options`: ``--trees``, a file of plants that commands add to a scene
- `scene_arguments`: the argument SCENE with its options, and opening the scene; `arguments`: parses other texts
- `options`: shared options, checks of the files they name, and the signatures of commands
- `interruption`: signals that end the command
- `console`: progress and errors on standard error; answers on standard output, also as Markdown
"""

import gc
import os
import sys

from .interruption import catch_signals, set_working


def main(arguments: list[str] | None = None) -> int:
    """Run the command line on `arguments` (None: those of the process) and return the exit code.

    0: success. 1: unexpected error. 2: unusable input, which never works. 75: unavailable for now, so try again.
    128 and more: ended by a signal, 130 by Ctrl-C.
    """
    if arguments is not None:
        return _run(arguments)
    catch_signals()
    # Importing Numba and reading its cache creates a million objects that live as long as the process. Traversing
    # them again and again would cost the garbage collector a sixth of the time of a small rendering.
    gc.set_threshold(200_000, 20, 20)
    try:
        code = _run(sys.argv[1:])
        _leave_ray(code)
        return code
    finally:
        set_working(False)


def _run(arguments: list[str]) -> int:
    from .app import run
    from .console import guarded

    return guarded(run, arguments)


def _leave_ray(code: int) -> None:
    """End the process here if Ray, whose cluster has lost its head, would not let it end with its exit code."""
    executor = sys.modules.get("antumbra.cluster.ray_executor")
    if executor is not None and executor.is_waiting_for_head():
        sys.stdout.flush()
        os._exit(code)
