"""A command: what it is for, which arguments it has, and where its work is done."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module

AddArguments = Callable[[ArgumentParser], None]


@dataclass(frozen=True)
class Command:
    """A command: its purpose in one line and in detail; `add_arguments`, which is called `of_<module>`, declares its
    arguments; that module here has `run(args)`.
    """

    about: str
    more: str
    add_arguments: AddArguments

    @property
    def _module(self) -> str:
        return self.add_arguments.__name__.removeprefix("of_")

    @property
    def name(self) -> str:
        """What it is called on the command line; a module cannot be called `import`."""
        return self._module.rstrip("_")

    def load(self) -> Callable[[Namespace], int | None]:
        """Import the function that does the work and returns the exit code, if it is not 0; it raises InputError,
        StorageError, DeviceError, RefusalError, GradeError.
        """
        run: Callable[[Namespace], int | None] = import_module(f"scanner.commands.{self._module}").run
        return run
