"""Pages from templates: text from files and devices is escaped."""

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

from markupsafe import Markup

from scanner.shown_text import unbroken

if TYPE_CHECKING:
    from jinja2 import Environment


def page(name: str, *, runs: str = "", **values: object) -> str:
    """The template `name` with these values. `runs`: a script of this package for the page."""
    if runs:
        values |= {"script": script(runs), "script_hash": script_hash(script(runs))}
    return _environment().get_template(name).render(values)


@cache
def _environment() -> "Environment":
    from jinja2 import Environment, PackageLoader, StrictUndefined  # takes a twentieth of a second

    made = Environment(
        loader=PackageLoader("scanner"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["unbroken"] = unbroken
    return made


@cache
def script(name: str) -> Markup:
    """A trusted script, inserted without escaping."""
    return Markup(files("scanner").joinpath(f"templates/{name}").read_text(encoding="utf-8"))


def script_hash(text: str) -> str:
    """Return the hash that a page's security policy uses to permit this script: a browser runs no other, and loads
    nothing.
    """
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"
