"""Captures of a network by its own devices: projector by projector shows its sequence, and all cameras see it."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from calib.geometry import Size
from hw.open_rig import OpenedNetwork, open_network
from hw.real_devices import PairSettings
from scanner.acquisition import PlannedCapture, take_together
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.networks.captures import Captures, Pair, labelled
from scanner.networks.sights import OnSight, PairProgress, Watched, nobody
from scanner.results import CAPTURES_FOLDER, Decoded
from scanner.ui import Progress


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


def take_pairs(pairs: Mapping[Pair, Config], folder: Path, progress: Progress, on_sight: OnSight = nobody) -> Captures:
    """Capture all pairs, each recorded in a folder of its own: projector by projector, while all others show black.

    Raises DeviceError, StorageError; what was captured before stays.
    """
    decoded: dict[Pair, Decoded] = {}
    sizes: dict[str, Size] = {}
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
                config, place = pairs[camera, projector], folder / CAPTURES_FOLDER / f"{camera}-{projector}"
                place.mkdir(parents=True)
                name = f"{camera} sees {projector} ({len(decoded) + len(planned) + 1} of {len(pairs)})"
                planned.append(PlannedCapture(name, config, place))
                sizes |= {camera: config.camera_size, projector: config.projector_size}
            rig = network.rig(together[0][1], [camera for camera, _ in together])
            with Watched(together, progress, on_sight) as watched:
                for pair, capture in zip(together, take_together(rig, planned, watched), strict=True):
                    decoded[pair] = labelled(capture, pairs[pair])
                    watched.decoded(pair, capture)
    return Captures(decoded, sizes)


def _shown_once(pairs: Mapping[Pair, Config], network: OpenedNetwork) -> Iterator[Sequence[Pair]]:
    """Pairs whose cameras see one and the same sequence of a projector, by projector."""
    for projector in dict.fromkeys(projector for _, projector in pairs):
        for cameras in network.together(projector):
            alike: dict[object, list[Pair]] = {}
            for pair in ((camera, projector) for camera in cameras):
                alike.setdefault((pairs[pair].sequence, pairs[pair].projector), []).append(pair)
            yield from alike.values()
