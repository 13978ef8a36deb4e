"""``python -m antumbra`` is the command ``antumbra``."""

import sys

from .cli import main

sys.exit(main())
