"""`python -m scanner` is the command `scan`."""

import sys

from scanner.commands.main import main

sys.exit(main())
