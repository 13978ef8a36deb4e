"""The command ``antumbra``.

- app: the program and its commands; failures: errors as one line and an exit code
- render, frames, renderarguments, picturespec, summary: ``antumbra render``, for pictures and animations
- page: HTML files of results; renderpage: that of ``render --html``
- explain, culling: pictures of the work of plans
- compare, comparearguments, comparesummary, comparepage: ``antumbra compare``, plans side by side
- bake: ``antumbra bake``, light and occlusion into glTF files
- view: ``antumbra view``, a scene in the browser
- sun, los, viewshed, matrix, dataset: the jobs; joboptions: their common options
- sharing, merge: the options --shard and --ray of jobs and pictures, and ``antumbra merge``
- build, info, warmup, plans: stores, contents of scenes, compiling ahead, and the list of methods
- doctor: the state of the installation; panels: options of help in groups
- scenes, export: procedural scenes, and their files
- bench, results, about: the commands of other packages, and the files of their results
- arguments, options, pictureoptions: parsing, and options that commands share; written: options that are made of those
  of the library; outputs: checks of what they write; sceneinput: opens a command's scene
- progress, report, record: progress on standard error, answers on standard output, and these as Markdown
"""

import gc
import sys


def main(arguments: list[str] | None = None) -> int:
    """Run the command line on `arguments` (None: those of the process) and return the exit code.

    0: success. 1: an unexpected error. 2: input that cannot be used. 130: interrupted.
    """
    if arguments is None:
        arguments = sys.argv[1:]
        # Importing Numba and reading its cache makes a million objects that live as long as the process. Python's
        # garbage collector would traverse them again and again. This takes a sixth of the time of a small rendering.
        gc.set_threshold(200_000, 20, 20)
    try:
        from .app import run
        from .console import guarded

        return guarded(run, arguments)
    except KeyboardInterrupt:  # during the imports
        print("antumbra: interrupted", file=sys.stderr)
        return 130
