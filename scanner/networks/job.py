"""The jobs of networks: from captures that exist, and live."""

from collections.abc import Sequence
from pathlib import Path

from scanner.configuration import Config
from scanner.networks.captures import Captures, read_pairs
from scanner.networks.live import check_stations, pairs_to_take, take_stations
from scanner.networks.save import save_network
from scanner.networks.sights import OnSight, nobody
from scanner.networks.solve import KnownDistance, SolvedNetwork, refuse_unknown, solve_network
from scanner.results import CAPTURES_FOLDER, Job
from scanner.ui import SILENT, Progress, Terminal


def scan_network(
    config: Config,
    out: Path,
    *,
    folders: Sequence[Path] = (),
    stations: int = 1,
    known: KnownDistance | None = None,
    overwrite: bool = False,
    terminal: Terminal = SILENT,
    progress: Progress | None = None,
    on_sight: OnSight = nobody,
) -> SolvedNetwork:
    """Calibrate all devices together from captures of their pairs in `folders`; or capture all pairs of the configured
    devices, at as many `stations`.

    `progress` receives the progress (default: the `terminal`), as in `scanner.jobs.scan`; `on_sight` is told of each
    pair, and of its frames. Raises InputError, DeviceError, RefusalError.
    """
    pairs = {} if folders else pairs_to_take(config)
    if pairs:
        refuse_unknown(known, {name for pair in pairs for name in pair})
        check_stations(pairs, stations, terminal)
    observer = progress or terminal

    def acquire(folder: Path) -> Captures:
        captures = (
            take_stations(pairs, stations, folder / CAPTURES_FOLDER, terminal, observer, on_sight)
            if pairs
            else read_pairs(folders, config, terminal)
        )
        refuse_unknown(known, captures.sizes)
        return captures

    job = Job(
        acquire,
        lambda captures: solve_network(captures, known, config, observer),
        lambda network, folder: save_network(network, folder, config),
    )
    return job.run(config, out, is_live=not folders, overwrite=overwrite, terminal=terminal)
