"""The commands: their arguments are in arguments.py, and each has a module with `run(args)`.

`scan` alone is the main job; the others are named by the first argument.
"""

from scanner.commands.arguments import NAMED
from scanner.commands.main import choose_command, main, parser_of
