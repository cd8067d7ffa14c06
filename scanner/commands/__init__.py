"""The commands: dataclasses of their options, in options_of_*.py; the work of each is in the module of its name.

`scan` alone is the main job; the others are named by the first argument.
"""

from scanner.commands.main import NAMED, choose_command, main, parser_of
