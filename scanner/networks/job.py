"""The jobs of networks: from captures that exist, and live."""

from collections.abc import Sequence
from pathlib import Path

from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.networks.captures import Captures, read_pairs
from scanner.networks.live import pairs_to_take, take_pairs
from scanner.networks.save import save_network
from scanner.networks.sights import OnSight, nobody
from scanner.networks.solve import KnownDistance, SolvedNetwork, refuse_unknown, solve_network
from scanner.networks.verdict import verdict_on
from scanner.results import new_result
from scanner.rooms.jobs import writing_refusals
from scanner.ui import Progress, Terminal

_SILENT = Terminal(quiet=True)


def network(
    folders: Sequence[Path],
    config: Config,
    out: Path,
    *,
    known: KnownDistance | None = None,
    overwrite: bool = False,
    terminal: Terminal,
) -> SolvedNetwork:
    """Calibrate all devices together from captures of their pairs. Raises InputError, RefusalError."""
    with new_result(out, config, overwrite=overwrite, tell=terminal.note) as folder, writing_refusals(folder, config):
        captures = read_pairs(folders, config, terminal)
        refuse_unknown(known, captures.sizes)
        return _saved(captures, config, folder, known, terminal)


def scan_network(
    config: Config,
    out: Path,
    *,
    known: KnownDistance | None = None,
    overwrite: bool = False,
    terminal: Terminal = _SILENT,
    progress: Progress | None = None,
    on_sight: OnSight = nobody,
) -> SolvedNetwork:
    """Capture all pairs of the configured devices, and calibrate them together.

    `progress` receives the progress (default: the `terminal`), as in `scanner.jobs.scan`; `on_sight` is told of each
    pair, and of its frames. Raises InputError, DeviceError, RefusalError.
    """
    pairs = pairs_to_take(config)
    refuse_unknown(known, {name for pair in pairs for name in pair})
    made = new_result(out, config, overwrite=overwrite, keep_capture=True, tell=terminal.note)
    with made as folder, writing_refusals(folder, config):
        captures = take_pairs(pairs, folder, progress or terminal, on_sight)
        return _saved(captures, config, folder, known, progress or terminal)


def _saved(
    captures: Captures, config: Config, folder: Path, known: KnownDistance | None, progress: Progress
) -> SolvedNetwork:
    solved = solve_network(captures, known, config, progress)
    verdict = verdict_on(solved)
    save_network(solved, verdict, folder, config)
    if verdict.grade == "refused":
        raise RefusalError(verdict.headline, verdict.advice)
    return solved
