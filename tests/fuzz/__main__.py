"""`python -m tests.fuzz`."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))  # as pytest does: what is damaged is made by its parts
from tests.fuzz.runner import main

sys.exit(main())
