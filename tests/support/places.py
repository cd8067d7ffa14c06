"""Where things are: the repository, and the real captures that may lie beside it."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
REAL_CAPTURES = ROOT.parent / "shared" / "data"
