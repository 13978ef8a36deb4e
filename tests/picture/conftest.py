"""A small hand-made frame: the left half sees a surface, the right half does not."""

import numpy as np
import pytest

from antumbra.picture.frame import Frame
from antumbra.query.gbuffer import GBuffer

H, W = 6, 8


@pytest.fixture
def frame() -> Frame:
    rng = np.random.default_rng(5)
    seen = np.zeros((H, W), bool)
    seen[:, : W // 2] = True
    image = np.where(seen[..., None], rng.uniform(0.0, 3.0, (H, W, 3)), 0.0).astype(np.float32)
    normal = np.where(seen[..., None], rng.normal(size=(H, W, 3)), 0.0).astype(np.float32)
    gbuffer = GBuffer(
        position=np.zeros((H, W, 3), np.float32),
        normal=normal,
        face=np.where(seen, 3, -1).astype(np.int32),
        depth=np.where(seen, rng.uniform(1.0, 9.0, (H, W)), np.inf).astype(np.float32),
        side=seen.astype(np.int8),
        origin=np.zeros(3),
    )
    visibility = [np.where(seen, rng.uniform(size=(H, W)), 1.0).astype(np.float32) for _ in range(2)]
    bits = [np.zeros((H, W, 1), np.uint64)] * 2
    return Frame(image, visibility, bits, gbuffer, 2 * 16 * int(seen.sum()), {"total": 1.0}, None)
