"""The command line as users run it, and the files that it leaves."""

from pathlib import Path

from scanner.commands import main


def run(*arguments: object) -> int:
    """Run `scan` with these arguments; returns the exit code."""
    return main([str(argument) for argument in arguments])


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}
