"""The extras of pyproject.toml, and the command that installs each.

The table is in `hw` because devices need it as well as commands. The command depends on how this program was
installed: from a checkout with the Makefile's environment, from a checkout in another one, or as a package. From a
checkout it is an editable installation, because `pip install '.[x]'` would replace that by a copy.
"""

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_FOLDER = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class OptionalPart:
    """An extra. `system`: Debian packages that it needs. `target`: the Makefile's target that installs both."""

    extra: str
    system: tuple[str, ...] = ()
    target: str | None = None

    def missing(self, what: str, package: str) -> str:
        """The message that `what` needs a missing package, with the command that installs it."""
        return f"{what} needs {package}, which is not installed; type: {self.install_command()}"

    @contextmanager
    def needed(self, what: str, package: str, error: type[Exception]) -> Iterator[None]:
        """If an import within fails, raise the `error` with that message."""
        try:
            yield
        except (ImportError, ValueError) as reason:  # ValueError: gi is there, what it should load is not
            raise error(self.missing(what, package)) from reason

    def install_command(self) -> str:
        """The shell command, relative to the present folder."""
        own = Path(sys.prefix).resolve() == _FOLDER / ".venv"
        if own and self.target:
            there = "" if Path.cwd() == _FOLDER else f"-C {shlex.quote(str(_FOLDER))} "
            return f"make {there}{self.target}"
        words = [_from_here(Path(sys.executable)), "-m", "pip", "install"]
        if (_FOLDER / "pyproject.toml").is_file():
            words += ["-e", f"{_from_here(_FOLDER)}[{self.extra}]"]
        else:
            words.append(f"roomscan[{self.extra}]")
        system = f"sudo apt-get install {shlex.join(self.system)} && " if self.system else ""
        return system + shlex.join(words)


def _from_here(path: Path) -> str:
    """A path, relative to the present folder if it is inside."""
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)


CONSOLE = OptionalPart("console")
BATCH = OptionalPart("batch")
E57 = OptionalPart("e57")
LAS = OptionalPart("las")
STEP = OptionalPart("step")
VIDEO = OptionalPart("video")
RIG = OptionalPart(
    "rig",
    system=("gir1.2-aravis-0.8", "libgirepository1.0-dev", "libcairo2-dev", "pkg-config", "gcc", "python3-dev"),
    target="rig",
)
GPHOTO2 = OptionalPart("gphoto2")
PARTS = (CONSOLE, BATCH, E57, GPHOTO2, LAS, STEP, VIDEO, RIG)
