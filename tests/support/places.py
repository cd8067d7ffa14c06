"""Paths: the repository, and the optional real captures beside it."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
REAL_CAPTURES = ROOT.parent / "shared" / "data"
