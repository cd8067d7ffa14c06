"""The jobs of networks: from captures that exist, and live.

Live, projector by projector shows its sequence, and all cameras see it.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from calib.geometry import Size
from calib.scene import FEWEST_STATIONS
from hw.open_rig import OpenedNetwork, at_place, moves_by_itself, open_network, turns_by_itself
from hw.real_devices import PairSettings
from scanner.acquisition import PlannedCapture, take_together
from scanner.capture import check_places
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.networks.captures import Captures, Pair, captures_of, folder_of, read_pairs
from scanner.networks.save import save_network
from scanner.networks.sights import OnSight, PairProgress, Watched, nobody
from scanner.networks.solve import KnownDistance, SolvedNetwork, refuse_unknown, solve_network
from scanner.results import CAPTURES_FOLDER, Decoded, Job
from scanner.ui import SILENT, Operator, Progress, Terminal

_TURN_IT = "Turn or tip what stands before the network by 10 to 30°, and leave the devices as they are"


def pairs_to_take(config: Config) -> dict[Pair, Config]:
    """The configuration of each pair, projector by projector. Raises InputError for what no capture could mend."""
    pairs = config.pairs
    if len(pairs) < 2:
        raise InputError("rigs: a network needs two pairs of devices or more; one camera and one projector are a rig")
    sizes: dict[str, Size] = {}
    for pair, own in pairs.items():
        for name, size in zip(pair, (own.camera_size, own.projector_size), strict=True):
            if sizes.setdefault(name, size) != size:
                raise InputError(
                    f"rigs: {name} has {size} pixels with {' and '.join(pair)}, and {sizes[name]} elsewhere"
                )
        own.principal_point(own.camera_size)
    backends = {own.required_rig.backend for own in pairs.values()}
    if "simulated" in backends and len(backends) > 1:
        raise InputError(
            "rigs: simulated devices see and light a room of their own; expected all of them to be, or none"
        )
    return pairs


def check_stations(pairs: Mapping[Pair, Config], stations: int, operator: Operator) -> None:
    """Raise InputError for a number that tells nothing, or that nobody could be asked to turn things for."""
    if not pairs or stations == 1:
        return
    if stations < FEWEST_STATIONS:
        raise InputError(
            f"--stations: expected {FEWEST_STATIONS} or more, or 1 before a corner of a room, found {stations}"
        )
    for config in pairs.values():
        rig = config.required_rig
        if moves_by_itself(rig) and not turns_by_itself(rig):
            raise InputError(f"--stations {stations}: in a simulated room nothing turns; set rig.thing.kind")
        check_places(rig, stations, operator, option="--stations", joined="scan network")


def take_stations(
    pairs: Mapping[Pair, Config],
    stations: int,
    folder: Path,
    operator: Operator,
    progress: Progress,
    on_sight: OnSight = nobody,
) -> Captures:
    """Capture all pairs at as many stations, or fewer if the operator ends. Between them, unless devices are simulated,
    the operator turns what stands before the network.

    Raises DeviceError, StorageError; what was captured before stays.
    """
    sizes: dict[str, Size] = {}
    for (camera, projector), config in pairs.items():
        sizes |= {camera: config.camera_size, projector: config.projector_size}
    taken: list[dict[Pair, Decoded]] = []
    for step in range(stations):
        by_itself = all(moves_by_itself(config.required_rig) for config in pairs.values())
        if step and not by_itself and not operator.ready(f"Station {step} of {stations} is done. {_TURN_IT}"):
            break
        at = {
            pair: config.model_copy(update={"rig": at_place(config.required_rig, step)})
            for pair, config in pairs.items()
        }
        taken.append(_take_pairs(at, folder_of(folder, step), progress, on_sight))
    return captures_of(taken, sizes, pairs.__getitem__)


def _take_pairs(
    pairs: Mapping[Pair, Config], folder: Path, progress: Progress, on_sight: OnSight
) -> dict[Pair, Decoded]:
    """Capture all pairs, each recorded in a folder of its own: projector by projector, while all others show black."""
    decoded: dict[Pair, Decoded] = {}
    for pair in pairs:
        on_sight(PairProgress(*pair), None)
    wanted = {
        pair: PairSettings(own.required_rig, own.camera_size, own.projector_size, own.projector.grid)
        for pair, own in pairs.items()
    }
    with ExitStack() as devices:
        with progress.step("Opening all devices"):
            network = devices.enter_context(open_network(wanted))
        for together in _shown_once(pairs, network):
            planned: list[PlannedCapture] = []
            for camera, projector in together:
                config, place = pairs[camera, projector], folder / f"{camera}-{projector}"
                place.mkdir(parents=True)
                name = f"{camera} sees {projector} ({len(decoded) + len(planned) + 1} of {len(pairs)})"
                planned.append(PlannedCapture(name, config, place))
            rig = network.rig(together[0][1], [camera for camera, _ in together])
            with Watched(together, progress, on_sight) as watched:
                for pair, capture in zip(together, take_together(rig, planned, watched), strict=True):
                    decoded[pair] = capture
                    watched.decoded(pair, capture)
    return decoded


def _shown_once(pairs: Mapping[Pair, Config], network: OpenedNetwork) -> Iterator[Sequence[Pair]]:
    """Pairs whose cameras see one and the same sequence of a projector, by projector."""
    for projector in dict.fromkeys(projector for _, projector in pairs):
        for cameras in network.together(projector):
            alike: dict[object, list[Pair]] = {}
            for pair in ((camera, projector) for camera in cameras):
                alike.setdefault((pairs[pair].sequence, pairs[pair].projector), []).append(pair)
            yield from alike.values()


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
