"""The jobs of networks: from captures that exist, and live."""

from collections.abc import Sequence
from pathlib import Path

from calib.refusal import RefusalError
from scanner.configuration import Config
from scanner.networks.captures import read_pairs
from scanner.networks.live import pairs_to_take, take_pairs
from scanner.networks.save import save_network
from scanner.networks.sights import OnSight, nobody
from scanner.networks.solve import KnownDistance, SolvedNetwork, refuse_unknown, solve_network
from scanner.networks.verdict import verdict_on
from scanner.results import new_result
from scanner.rooms import writing_refusals
from scanner.ui import SILENT, Progress, Terminal


def scan_network(
    config: Config,
    out: Path,
    *,
    folders: Sequence[Path] = (),
    known: KnownDistance | None = None,
    overwrite: bool = False,
    terminal: Terminal = SILENT,
    progress: Progress | None = None,
    on_sight: OnSight = nobody,
) -> SolvedNetwork:
    """Calibrate all devices together from captures of their pairs in `folders`; or capture all pairs of the configured
    devices.

    `progress` receives the progress (default: the `terminal`), as in `scanner.jobs.scan`; `on_sight` is told of each
    pair, and of its frames. Raises InputError, DeviceError, RefusalError.
    """
    pairs = {} if folders else pairs_to_take(config)
    if pairs:
        refuse_unknown(known, {name for pair in pairs for name in pair})
    observer = progress or terminal
    made = new_result(out, config, overwrite=overwrite, keep_capture=not folders, tell=terminal.note)
    with made as folder, writing_refusals(folder, config):
        captures = take_pairs(pairs, folder, observer, on_sight) if pairs else read_pairs(folders, config, terminal)
        refuse_unknown(known, captures.sizes)
        solved = solve_network(captures, known, config, observer)
        verdict = verdict_on(solved)
        save_network(solved, verdict, folder, config)
        if verdict.grade == "refused":
            raise RefusalError.of(verdict.findings[0])
    return solved
