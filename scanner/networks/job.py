"""The job of a network: from captures that exist."""

from collections.abc import Sequence
from pathlib import Path

from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.networks.captures import read_pairs
from scanner.networks.save import save_network
from scanner.networks.solve import KnownDistance, SolvedNetwork, refuse_unknown, solve_network
from scanner.networks.verdict import verdict_on
from scanner.results import new_result
from scanner.rooms.jobs import saying_why
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
    with new_result(out, config, overwrite=overwrite, tell=terminal.note) as folder, saying_why(folder, config):
        captures = read_pairs(folders, config, terminal)
        refuse_unknown(known, captures)
        solved = solve_network(captures, known, config, terminal)
        verdict = verdict_on(solved)
        save_network(solved, verdict, folder, config)
        if verdict.grade == "refused":
            raise RefusalError(verdict.headline, verdict.advice)
    return solved
