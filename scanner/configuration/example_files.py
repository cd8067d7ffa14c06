"""Commented example configurations: those of configs/, to which this folder has a link."""

from importlib.resources import files


def example(name: str) -> str:
    """The text of one, by the name of its file."""
    return (files("scanner.configuration") / "examples" / name).read_text(encoding="utf-8")
