import pytest

from antumbra.web.javascript_package import build_package
from pages import headless


@pytest.fixture(scope="session")
def package(tmp_path_factory):
    """The folder of the package for JavaScript."""
    folder = tmp_path_factory.mktemp("javascript")
    build_package(folder)
    return folder


@pytest.fixture(scope="module")
def chromium():
    with headless() as started:
        yield started
