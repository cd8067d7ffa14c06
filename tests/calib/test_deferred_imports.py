"""Packages that import a name when it is first asked for offer what the type checker sees, and nothing twice."""

import re
from importlib import import_module
from pkgutil import iter_modules

import pytest

from tests.support.places import ROOT

PACKAGES = sorted(
    ".".join(path.relative_to(ROOT).parent.parts)
    for package in ("calib", "hw", "scanner")
    for path in (ROOT / package).rglob("__init__.py")
    if "defer_imports(" in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_offers_what_the_type_checker_sees(package: str) -> None:
    text = (ROOT.joinpath(*package.split(".")) / "__init__.py").read_text(encoding="utf-8")
    typed = re.findall(r"^    from .* import (\w+) as \1$", text, flags=re.MULTILINE)
    offered = import_module(package)
    assert sorted(typed) == offered.__all__
    assert all(getattr(offered, name) is not None for name in offered.__all__)
    assert set(offered.__all__) < set(dir(offered))


@pytest.mark.parametrize("package", PACKAGES)
def test_no_name_is_that_of_a_module(package: str) -> None:
    """Which would take its place as soon as it is loaded."""
    offered = import_module(package)
    assert len(offered.__all__) > 3
    assert {module.name for module in iter_modules(offered.__path__)}.isdisjoint(offered.__all__)


def test_what_is_not_offered_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'calib' has no attribute 'corner'"):
        _ = import_module("calib").corner
