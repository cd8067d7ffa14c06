"""Packages whose names are imported when they are first asked for (PEP 562)."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def defer_imports(
    package: str, homes: Mapping[str, str]
) -> tuple[list[str], Callable[[str], object], Callable[[], list[str]]]:
    """`__all__`, `__getattr__` and `__dir__` of `package`, which offers what its modules hold without loading them.

    `homes` has the names that each module offers, between spaces: {"geometry": "Corner Matches"}. None may be the name
    of a module of the package, which would take its place. A type checker does not see them: the package imports them
    under `TYPE_CHECKING` as well.
    """
    home_of = {name: home for home, names in homes.items() for name in names.split()}

    def get(name: str) -> object:
        if name not in home_of:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(f"{package}.{home_of[name]}"), name)

    return sorted(home_of), get, lambda: sorted({*vars(sys.modules[package]), *home_of})
