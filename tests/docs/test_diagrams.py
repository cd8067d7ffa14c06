"""The diagrams are what their script draws, have words for who cannot see them, and stay small."""

from collections.abc import Callable
from xml.etree import ElementTree

import pytest

from tests.docs.test_configuration_reference import module
from tests.support.places import ROOT

SVG = "{http://www.w3.org/2000/svg}"
MOST_BYTES = 40_000


@pytest.fixture(scope="module")
def diagrams() -> dict[str, Callable[[], object]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "docs")
        return dict(module(ROOT / "docs" / "make_diagrams.py").DIAGRAMS)


def test_stored_diagrams_are_current(diagrams: dict[str, Callable[[], object]]) -> None:
    assert len(diagrams) >= 10
    for name, draw in diagrams.items():
        written = (ROOT / "docs" / "images" / f"{name}.svg").read_text(encoding="utf-8")
        assert written == str(draw()), f"{name}.svg is stale: run python docs/make_diagrams.py"
        assert len(written.encode()) < MOST_BYTES
        drawing = ElementTree.fromstring(written)
        assert all(len(drawing.findtext(f"{SVG}{tag}") or "") > 10 for tag in ("title", "desc"))
