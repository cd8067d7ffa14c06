"""What an installation may lack, and what to type to get it: the one table of the extras of pyproject.toml.

It is down here because devices need it as well as commands. What to type depends on how this program was installed:
from a checkout whose Makefile made the environment, from a checkout in another environment, or as a package. An
installation that runs from a checkout stays one: `pip install '.[x]'` would put a copy in its place.
"""

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

_FOLDER = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Part:
    """An extra. Where it needs Debian packages of the system, a target of the Makefile installs both."""

    extra: str
    system: tuple[str, ...] = ()
    target: str | None = None

    def missing(self, what: str, package: str) -> str:
        """The sentence that says that `what` needs a package which is not installed, and what to type."""
        return f"{what} needs {package}, which is not installed; type: {self.install_command()}"

    def install_command(self) -> str:
        """What to type into a shell in the present folder."""
        own = Path(sys.prefix).resolve() == _FOLDER / ".venv"
        if own and self.target:
            return f"make {self.target}" if _is_here(_FOLDER) else f"make -C {shlex.quote(str(_FOLDER))} {self.target}"
        words = [_from_here(Path(sys.executable)), "-m", "pip", "install"]
        if (_FOLDER / "pyproject.toml").is_file():
            words += ["-e", f"{_from_here(_FOLDER)}[{self.extra}]"]
        else:
            words.append(f"roomscan[{self.extra}]")
        system = f"sudo apt-get install {shlex.join(self.system)} && " if self.system else ""
        return system + shlex.join(words)


def _is_here(folder: Path) -> bool:
    return Path.cwd() == folder


def _from_here(path: Path) -> str:
    """A path, relative to the present folder if it is in it."""
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)


CONSOLE = Part("console")
BATCH = Part("batch")
E57 = Part("e57")
VIDEO = Part("video")
RIG = Part(
    "rig",
    system=("gir1.2-aravis-0.8", "libgirepository1.0-dev", "libcairo2-dev", "pkg-config", "gcc", "python3-dev"),
    target="rig",
)
GPHOTO2 = Part("gphoto2")
PARTS = (CONSOLE, BATCH, E57, GPHOTO2, VIDEO, RIG)
