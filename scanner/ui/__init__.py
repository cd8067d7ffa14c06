"""The terminal: steps, messages, exit codes, the log."""

from scanner.ui.exit_codes import EXIT_BUG, EXIT_DIFFERENT, EXIT_INPUT, EXIT_REFUSED, failure_of
from scanner.ui.log_file import LogFile, keep_off_the_terminal
from scanner.ui.operator import Operator, Progress
from scanner.ui.terminal import SILENT, Terminal, for_screen
