"""The site builds without warnings, loads nothing external, and all links have targets."""

import re
import subprocess
import sys
from pathlib import Path

from tests.support.documented import PAGES
from tests.support.places import ROOT

TEXTS = [*PAGES, *ROOT.glob("*.md"), *(ROOT / "docs" / "decisions").glob("*.md")]


def anchors(page: Path) -> set[str]:
    """Anchors that GitHub and MkDocs make of headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_link_has_a_target() -> None:
    dead, count = [], 0
    for page in TEXTS:
        for target in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
            if target.startswith("http"):
                continue
            count += 1
            file, _, anchor = target.partition("#")
            place = page.parent / file if file else page
            if not place.exists() or (anchor and anchor not in anchors(place)):
                dead.append((page.name, target))
    assert dead == []
    assert count > 100


def test_the_site_builds(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    pages = {page: page.read_text(encoding="utf-8") for page in (tmp_path / "site").rglob("*.html")}
    loaded = re.compile(r'(?:<script[^>]*|<img[^>]*)src="https?:|<link[^>]*rel="stylesheet"[^>]*href="https?:')
    assert [page.name for page, html in pages.items() if loaded.search(html)] == []
    assert "<math" in pages[tmp_path / "site" / "method" / "index.html"]
    assert "arithmatex" not in pages[tmp_path / "site" / "method" / "index.html"]
