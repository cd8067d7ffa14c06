"""Pages from templates: text from files and devices is escaped."""

import base64
import hashlib
from functools import cache
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from scanner.shown_text import unbroken


@cache
def environment() -> Environment:
    """Return the Jinja environment with all templates of this package."""
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
