"""Every module imports without a warning, and so does each name of the public face: the least that another Python must do."""

import importlib
import importlib.util
import pkgutil

import sunspin


def modules() -> list[str]:
    """All modules of the package but programs and the texts from which kernels are made."""
    found = [module.name for module in pkgutil.walk_packages(sunspin.__path__, "sunspin.")]
    return [name for name in found if not name.endswith(("_template", "__main__"))]


NEEDS = {"sunspin.compute.cluster": "distributed"}
"""Modules of an extra, which is not everywhere."""


def test_every_module_imports():
    assert len(modules()) > 150
    for name in modules():
        if name not in NEEDS or importlib.util.find_spec(NEEDS[name]) is not None:
            importlib.import_module(name)


def test_every_public_name_is_there():
    for name in sunspin.__all__:
        assert getattr(sunspin, name) is not None, name
