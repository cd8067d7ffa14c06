"""What the site needs beyond MkDocs: equations as MathML, and no links out of the documentation's folder."""

import re
from html import unescape

from latex2mathml.converter import convert

_EQUATION = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_OUTSIDE = re.compile(r"\[([^\]]+)\]\(\.\./[^)]*\)")
_DECISIONS = re.compile(r"\]\(decisions\)")


def on_page_markdown(markdown: str, **_: object) -> str:
    """Files beside the documentation are no part of the site: their names stay, without a link."""
    return _DECISIONS.sub("](decisions/README.md)", _OUTSIDE.sub(r"`\1`", markdown))


def on_page_content(html: str, **_: object) -> str:
    """Equations become MathML, which browsers draw without a script of another host."""
    return _EQUATION.sub(_as_mathml, html)


def _as_mathml(found: re.Match[str]) -> str:
    return convert(unescape(found[2]), display="block" if found[1] == "div" else "inline")
