import pytest

pytest.importorskip("viser", reason="the page needs the extra 'console'")
pytest.importorskip("playwright", reason="pages are tested with Playwright")
