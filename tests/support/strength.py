"""How many examples Hypothesis tries: a few in the default run, all of them by ``pytest -m volume``.

`selection` loads one of two profiles before tests are collected, and `examples` scales its count to that profile.
"""

import os

from hypothesis import settings

FULL = 100  # examples of a test without a count of its own, at full strength
FEW = 15

settings.register_profile("default", max_examples=FEW, deadline=None, print_blob=True, derandomize="CI" in os.environ)
settings.register_profile("volume", settings.get_profile("default"), max_examples=FULL)


load_profile = settings.load_profile


def examples(count: int, **others: object) -> settings:
    """Settings of a property test that tries so many examples at full strength.

    In the default run it tries a share of them, of at least five where there are so many.
    """
    share = count * settings.default.max_examples // FULL
    return settings(max_examples=max(min(count, 5), share), **others)
