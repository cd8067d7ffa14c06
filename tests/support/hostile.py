"""Names and texts that would be more than text, and what a page looks like that takes them for it."""

from playwright.sync_api import Page

TAKEN = "window.taken = 1"
TEXT = (
    f"""<img src=x onerror="{TAKEN}">'`![x](x)[y](javascript:{TAKEN})`{{{{7*7}}}}"""
    f"\x1b[31m\nred<script>{TAKEN}<!--"
)
FILE_NAME = TEXT.replace("/", "")
_ELEMENTS = """() => [...document.querySelectorAll("*")]
  .filter(element => /\\bx$/.test(element.getAttribute("src") || "") || /^javascript:/.test(element.href || "")
    || [...element.attributes].some(attribute => attribute.name.startsWith("on")))
  .map(element => element.outerHTML)"""


def assert_harmless(page: Page) -> None:
    """Nothing of the texts became an element, or ran."""
    assert page.evaluate("window.taken") is None
    assert page.evaluate(_ELEMENTS) == []
