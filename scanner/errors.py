"""Errors of the application; the command line turns each into its exit code."""


class InputError(Exception):
    """A wrong argument, configuration or input file. The message says what was expected, what was found, what to do."""
