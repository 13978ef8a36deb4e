import pytest

from antumbra.web.javascript_package import build_package


@pytest.fixture(scope="session")
def package(tmp_path_factory):
    """The folder of the package for JavaScript."""
    folder = tmp_path_factory.mktemp("javascript")
    build_package(folder)
    return folder
