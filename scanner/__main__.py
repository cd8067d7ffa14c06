"""`python -m scanner` is the command `scan`."""

import sys

from scanner.cli import main

sys.exit(main())
