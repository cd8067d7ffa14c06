"""`python -m scanner` is the command `scan`."""

import gc
import signal
import sys

from scanner.interruption import end_at_once, on_ending

_OBJECTS = (
    50_000  # made before the garbage collector looks at them: what is loaded stays, and looking took a sixth of it
)


def run() -> int:
    """The whole process, whose exit code is returned: not even while modules are loaded has Ctrl-C a traceback."""
    on_ending(end_at_once)
    gc.set_threshold(_OBJECTS)
    from scanner.commands.main import main

    code = main()
    on_ending(signal.SIG_IGN)  # everything is reported; a handler would disappear before the process does
    return code


if __name__ == "__main__":
    sys.exit(run())
