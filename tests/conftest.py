"""Settings of all tests."""

import os

from hypothesis import settings

# Continuous integration repeats the same examples each time; developers' runs search on.
settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")
