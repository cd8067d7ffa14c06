"""Captures of a network by its own devices: each projector shows its sequence to one camera after the other."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from itertools import groupby
from pathlib import Path

import numpy as np

from calib.geometry import Size
from hw.projector.process import ScreenProjector
from hw.settings import CameraRigSettings
from scanner.configuration import Config
from scanner.errors import InputError
from scanner.networks.captures import Captures, Pair, labelled
from scanner.networks.sights import OnSight, Sight, Watched, nobody
from scanner.pipeline import take
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
    """Capture each pair in turn, each recorded in a folder of its own, while all other projectors show black.

    Raises DeviceError, StorageError; what was captured before stays.
    """
    decoded: dict[Pair, Decoded] = {}
    sizes: dict[str, Size] = {}
    for pair in pairs:
        on_sight(Sight(*pair), None)
    for projector, alike in groupby(pairs, key=lambda pair: pair[1]):
        with _others_black(pairs, projector):
            for camera, _ in alike:
                config = pairs[camera, projector]
                place = folder / CAPTURES_FOLDER / f"{camera}-{projector}"
                place.mkdir(parents=True)
                name = f"{camera} sees {projector} ({len(decoded) + 1} of {len(pairs)})"
                with Watched([(camera, projector)], progress, on_sight) as watched:
                    taken = take(config.required_rig, config, place, watched, name)
                    decoded[camera, projector] = labelled(taken, config)
                    watched.decoded((camera, projector), taken)
                sizes |= {camera: config.camera_size, projector: config.projector_size}
    return Captures(decoded, sizes)


@contextmanager
def _others_black(pairs: Mapping[Pair, Config], projector: str) -> Iterator[None]:
    """Black on the screens of all other projectors; in a simulated room they are dark by themselves."""
    others = {name: own for (_, name), own in pairs.items() if name != projector}
    with ExitStack() as screens:
        for own in others.values():
            rig, (width, height) = own.required_rig, own.projector_size
            if isinstance(rig, CameraRigSettings):
                screen = screens.enter_context(ScreenProjector(rig.screen, (width, height)))
                screen.prepare(np.zeros((height, width), np.uint8))
                screen.flip()
        yield
