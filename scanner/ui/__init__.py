"""What a person at a terminal sees: steps, messages, exit codes, the log."""

from scanner.ui.exit_codes import failure_of
from scanner.ui.fitting import for_screen
from scanner.ui.log_file import LogFile, keep_off_the_terminal
from scanner.ui.progress import Progress
from scanner.ui.terminal import Terminal
