"""Devices for tests."""

import pytest

from fake_cuda import FakeCuda, built


@pytest.fixture(scope="session")
def fake_cuda_library(tmp_path_factory):
    return built(tmp_path_factory.mktemp("cuda"))


@pytest.fixture
def fake_cuda(fake_cuda_library, monkeypatch):
    """A CUDA driver whose cards are the host."""
    driver = FakeCuda(fake_cuda_library)
    driver.use(monkeypatch)
    yield driver
    driver.restart()
