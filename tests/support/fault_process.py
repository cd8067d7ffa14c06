"""A process that forks scanners, each with an injected fault; requests come on stdin.

Modules are loaded once, so that a scan as a real process, which is really killed, costs no second. The rig is a
projector whose camera sees its picture; everything after decoding is replaced by a file that looks like it.
"""

import ctypes
import errno
import json
import os
import resource
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from hw.open_rig import OpenedRig
from hw.rig import Capabilities, Frame, Rig
from scanner import acquisition, jobs
from scanner.commands import main
from scanner.commands import scan as scan_command
from tests.support.small_capture import SIZE

_NEW_MOUNTS, _NEW_USER = 0x00020000, 0x10000000
_PRIVATE, _READ_ONLY = 0x4000 | 0x40000, 1
CANNOT_MOUNT = 99


class Mirror:
    """A projector, and a camera that sees its picture."""

    size = SIZE
    highest_level = 255
    capabilities = Capabilities()

    def __init__(self) -> None:
        self._shown = np.zeros(SIZE[::-1], np.uint8)

    def show(self, image: np.ndarray) -> None:
        self._shown = image

    def grab(self) -> Frame:
        return Frame(self._shown // 2 + 20)


@contextmanager
def open_mirror(*_: object) -> Iterator[OpenedRig]:
    mirror = Mirror()
    yield OpenedRig(Rig(mirror, mirror, {"camera": "mirror"}), None)


def reconstruct(captures: Any, config: Any, folder: Path, *_: object, **__: object) -> None:
    (folder / "report.html").write_text(os.environ.get("SCAN_SAYS", "new"))


def found(place: str) -> tuple[Any, str]:
    """The owner of a function, by `module:function` or `module:class.function`, and its name there."""
    module, names = place.split(":")
    *owners, name = names.split(".")
    owner: Any = import_module(module)
    for each in owners:
        owner = getattr(owner, each)
    return owner, name


def plant(fault: dict[str, Any]) -> None:
    """Run an action before the n-th call of a function."""
    module, name = found(fault["at"])
    real, calls = getattr(module, name), count(1)

    def faulty(*arguments: Any, **named: Any) -> Any:
        if next(calls) == fault.get("call", 1):
            ACTIONS[fault["do"]](real, arguments, fault)
        return real(*arguments, **named)

    setattr(module, name, faulty)


def send(*numbers: int) -> Callable[..., None]:
    def act(*_: object) -> None:
        for number in numbers:
            os.kill(os.getpid(), number)

    return act


def half_an_image(real: Callable[..., None], arguments: tuple[Any, ...], _: object) -> None:
    real(*arguments)
    os.truncate(arguments[0], arguments[0].stat().st_size // 2)
    os.kill(os.getpid(), signal.SIGKILL)


def half_a_line(_: object, arguments: tuple[Any, ...], __: object) -> None:
    listing, text = arguments
    listing.write(text.encode()[: len(text) // 2])
    os.kill(os.getpid(), signal.SIGKILL)


def fill_the_disk(_: object, __: object, fault: dict[str, Any]) -> None:
    with Path(fault["where"], "filling").open("wb") as file:
        try:
            while True:
                file.write(bytes(4096))
                file.flush()
        except OSError:
            pass


def refuse_to_write(*_: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def another_scan(_: object, __: object, fault: dict[str, Any]) -> None:
    child = os.fork()
    if child == 0:
        sys.stderr.flush()
        os._exit(main(fault["arguments"]))
    Path(fault["where"]).write_text(str(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])))


ACTIONS: dict[str, Callable[..., None]] = {
    "SIGKILL": send(signal.SIGKILL),
    "SIGTERM": send(signal.SIGTERM),
    "SIGHUP": send(signal.SIGHUP),
    "Ctrl-C": send(signal.SIGINT),
    "Ctrl-C again and again": send(signal.SIGINT, signal.SIGINT, signal.SIGTERM),
    "half an image": half_an_image,
    "half a line": half_a_line,
    "full disk": fill_the_disk,
    "no room": refuse_to_write,
    "another scan": another_scan,
}


def mount(where: str, options: str, *, read_only: bool) -> None:
    """Mount a small private file system. Ends the process if that is not allowed."""
    libc = ctypes.CDLL(None, use_errno=True)
    user, group = os.getuid(), os.getgid()
    if libc.unshare(_NEW_MOUNTS | (_NEW_USER if user else 0)) != 0:
        os._exit(CANNOT_MOUNT)
    if user:
        for name, text in (("setgroups", "deny"), ("uid_map", f"0 {user} 1"), ("gid_map", f"0 {group} 1")):
            Path("/proc/self", name).write_text(text)
    libc.mount(b"none", b"/", None, _PRIVATE, None)
    if libc.mount(b"tmpfs", where.encode(), b"tmpfs", _READ_ONLY * read_only, options.encode()) != 0:
        os._exit(CANNOT_MOUNT)


def tree(folder: Path) -> dict[str, str]:
    """Every file below a folder, with the content of short ones."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): path.read_text(errors="replace")[:10_000] for path in files}


def child(request: dict[str, Any]) -> None:
    """Run one scan; leave its output and files for the caller."""
    with Path(request["report"]).open("w") as report:  # open before limits and mounts
        os.dup2(report.fileno(), 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.environ["SCAN_SAYS"] = request.get("says", "new")
        if mounted := request.get("mount"):
            mount(mounted["where"], mounted.get("options", ""), read_only=mounted.get("read_only", False))
        if "largest_file" in request:
            limits = resource.getrlimit(resource.RLIMIT_FSIZE)
            resource.setrlimit(resource.RLIMIT_FSIZE, (request["largest_file"], limits[1]))
        for fault in request.get("faults", ()):
            plant(fault)
        for name, value in request.get("replace", {}).items():
            setattr(*found(name), lambda *_, value=value, **__: value)
        code = main(request["arguments"])
        sys.stderr.flush()
        if mounted:
            Path(request["report"]).with_suffix(".tree").write_text(json.dumps(tree(Path(mounted["where"]))))
        os._exit(code)


def serve() -> None:
    """Fork for each line of stdin; report the exit code, or minus the signal, on stdout."""
    setattr(acquisition, "open_rig", open_mirror)  # noqa: B010
    setattr(jobs, "reconstruct", reconstruct)  # noqa: B010
    setattr(scan_command, "show_outcome", lambda *_: None)  # noqa: B010
    signal.signal(signal.SIGINT, signal.default_int_handler)
    cv2.setNumThreads(0)  # no thread may be running when this process forks
    with TemporaryDirectory() as folder:
        config = Path(folder, "warm.yaml")
        config.write_text(
            "rig: {backend: simulated}\ncamera: {width: 48, height: 32}\nprojector: {width: 48, height: 32}\n"
        )
        main(["--config", str(config), "--out", str(Path(folder, "warm")), "--quiet"])
    print("ready", flush=True)
    for line in sys.stdin:
        forked = os.fork()
        if forked == 0:
            try:
                child(json.loads(line))
            finally:
                os._exit(98)
        print(os.waitstatus_to_exitcode(os.waitpid(forked, 0)[1]), flush=True)


if __name__ == "__main__":
    serve()
