"""The verdict on a result, read back from its report."""

from html.parser import HTMLParser
from pathlib import Path
from typing import get_args

from scanner.reporting.verdict import Grade, Verdict
from scanner.result import REPORT_FILE

_PARTS = {"h2": "headline", "li": "reason", "p": "advice"}


def read_verdict(folder: Path) -> Verdict | None:
    """What the report of a result folder concludes; None if there is no report, or one without a verdict."""
    try:
        page = (folder / REPORT_FILE).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None  # the cloud can be looked at without it
    reader = _Reader()
    reader.feed(page)
    return reader.verdict


class _Reader(HTMLParser):
    """Collects the texts of the section of class 'verdict', whose second class is the grade."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self._grade: Grade | None = None
        self._within = False
        self._part = ""
        self._texts: list[tuple[str, list[str]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        classes = (dict(attrs).get("class") or "").split()
        if tag == "section" and "verdict" in classes:
            self._within = True
            self._grade = next((grade for grade in get_args(Grade) if grade in classes), None)
        elif self._within and tag in _PARTS:
            self._part = _PARTS[tag]
            self._texts.append((self._part, []))

    def handle_endtag(self, tag: str) -> None:
        if tag == "section":
            self._within = False
        if tag in _PARTS:
            self._part = ""

    def handle_data(self, data: str) -> None:
        if self._within and self._part:
            self._texts[-1][1].append(data)

    @property
    def verdict(self) -> Verdict | None:
        found = [(part, " ".join("".join(texts).split())) for part, texts in self._texts]
        headline = next((text for part, text in found if part == "headline"), "")
        if self._grade is None or not headline:
            return None
        _, _, plain = headline.partition(" ")  # after the sign that stands for the grade
        reasons = tuple(text for part, text in found if part == "reason")
        return Verdict(self._grade, plain, reasons, next((text for part, text in found if part == "advice"), ""))
