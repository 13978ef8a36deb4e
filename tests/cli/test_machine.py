from antumbra import __version__
from antumbra.cli import machine as module
from antumbra.cli.machine import machine


def test_the_machine_and_its_versions():
    told = machine(3)
    assert (told["threads"], told["antumbra"]) == (3, __version__) and told["cores"] >= 1
    assert all(told[name] for name in ("processor", "level", "system", "python", "numpy", "numba"))


def test_packages_that_are_not_installed(monkeypatch):
    assert module._version("no-such-package-of-ours") == "unknown"


def test_without_the_list_of_processors(monkeypatch):
    monkeypatch.setattr(module.Path, "read_text", lambda *_, **__: (_ for _ in ()).throw(FileNotFoundError()))
    assert machine(1)["processor"]
