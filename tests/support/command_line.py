"""The program as its user calls it, and what it leaves in a folder."""

from pathlib import Path

from scanner.commands.main import main


def run(*arguments: object) -> int:
    """The exit code of `scan` with these arguments."""
    return main([str(argument) for argument in arguments])


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}
