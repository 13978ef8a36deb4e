"""``python -m antumbra`` runs the command ``antumbra``."""

import sys

from .cli import main

sys.exit(main())
