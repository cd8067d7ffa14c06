"""The jobs of networks: from captures that exist, and live."""

from collections.abc import Sequence
from pathlib import Path

from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.networks.captures import Captures, read_pairs
from scanner.networks.live import pairs_to_take, take_pairs
from scanner.networks.save import save_network
from scanner.networks.solve import KnownDistance, SolvedNetwork, refuse_unknown, solve_network
from scanner.networks.verdict import verdict_on
from scanner.results import new_result
from scanner.rooms.jobs import writing_refusals
from scanner.ui import Terminal


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
        return _saved(read_pairs(folders, config, terminal), config, folder, known, terminal)


def scan_network(
    config: Config,
    out: Path,
    *,
    known: KnownDistance | None = None,
    overwrite: bool = False,
    terminal: Terminal,
) -> SolvedNetwork:
    """Capture all pairs of the configured devices, and calibrate them together.

    Raises InputError, DeviceError, RefusalError.
    """
    pairs = pairs_to_take(config)
    made = new_result(out, config, overwrite=overwrite, keep_capture=True, tell=terminal.note)
    with made as folder, writing_refusals(folder, config):
        return _saved(take_pairs(pairs, folder, terminal), config, folder, known, terminal)


def _saved(
    captures: Captures, config: Config, folder: Path, known: KnownDistance | None, terminal: Terminal
) -> SolvedNetwork:
    refuse_unknown(known, captures)
    solved = solve_network(captures, known, config, terminal)
    verdict = verdict_on(solved)
    save_network(solved, verdict, folder, config)
    if verdict.grade == "refused":
        raise RefusalError(verdict.headline, verdict.advice)
    return solved
