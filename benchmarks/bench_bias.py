"""The effect of each of the decoder's corrections: mean errors over whole faces with each switched off.

    python benchmarks/bench_bias.py [--seeds 0 1 2] [--under '{"ambient": 1.0}'] [--exposure 0.25]

Furnished rooms with all light transport on; camera of 612 × 512 pixels, projector of 427 × 240, once narrow as in the
rig (focal length 1.46 widths) and once wide (0.8). Means over the matches of a face, weighted as a calibration
does, in thousandths of a projector pixel; matches that err by more than five sigmas are left out, as there. 'peer':
plain least squares on the same frames, without any correction (`conditions/plain_decoder.py`).
"""

import argparse
import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import import_module
from unittest.mock import patch

import numpy as np
from conditions.captures import Capture, patterns_of, take
from conditions.plain_decoder import plain_matches

from calib.geometry import Matches
from calib.numerics import Floats
from hw.settings import SimulatedRigSettings
from hw.simulated import DrawnRoom, GroundTruth, SimulatedRoom, simulation
from scanner.decoding import Decoder
from scanner.decoding.fringes import Footprint

CAMERA, PROJECTOR = (612, 512), (427, 240)
WIDTHS = {"narrow": None, "wide": 0.8}
FACES = ("wall x", "wall y", "floor")
OUTLYING = 5.0


def _nothing(*_: object) -> None:
    return None


# Replacements of corrections, by module, object and name.
Off = tuple[tuple[str, str, Callable[..., object]], ...]
SWITCHED_OFF: dict[str, Off] = {
    "all corrections": (),
    "without straightening of gamma": (("coordinates.decoder_calibration", "straightening", _nothing),),
    "without shading": (("coordinates.coordinate_map", "footprint_of", lambda *_: Footprint.round(0.0)),),
    "without comparing periods": (("coordinates.axis_decoder", "correct_systematic", _nothing),),
    "without equalising": (
        ("corrections.gains", "gains_of_fringes", lambda *_: {}),
        ("corrections.corrected_frames", "gains_of_pairs", lambda *_: {}),
        ("sample_analysis", "gains_of_pairs", lambda *_: {}),
    ),
    "without taking motion back": (("motion.rigid_motion", "CoordinateShift.subtracted_from", lambda _, px: px),),
    "with wrong bits left": (("coordinates.axis_decoder", "resolve_contradictory_codes", _nothing),),
}


@contextmanager
def switched_off(names: Off) -> Iterator[None]:
    with ExitStack() as stack:
        for module, path, instead in names:
            *owners, name = path.split(".")
            owner: object = import_module(f"scanner.decoding.{module}")
            for each in owners:
                owner = getattr(owner, each)
            stack.enter_context(patch.object(owner, name, instead))
        yield


def room_of(settings: SimulatedRigSettings, widths: float | None) -> SimulatedRoom:
    """A room whose projector has this focal length in picture widths; None for the rig's own."""
    place = simulation.place_room

    def placed(*where: object) -> DrawnRoom:
        room = place(*where)  # type: ignore[arg-type]
        if widths is None:
            return room
        optics = replace(room.projector.optics, focal_px=widths * room.projector.optics.width)
        return replace(room, projector=replace(room.projector, optics=optics))

    with patch.object(simulation, "place_room", placed):
        return SimulatedRoom(settings, CAMERA, PROJECTOR)


def decoded(capture: Capture) -> Matches:
    decoder = Decoder(capture.patterns, capture.projector_size)
    for frame in capture.frames:
        decoder.add(frame)
    return decoder.finish().matches


def means(matches: Matches, truth: GroundTruth) -> Floats:
    """Mean errors of the matches on each face (3, 2)."""
    x, y = np.rint(matches.camera_px).astype(int).T
    error, label = matches.projector_px - truth.projector_px[y, x], truth.label[y, x]
    sigma = matches.sigma_px if matches.sigma_px is not None else np.full(len(error), 0.05)
    kept = np.linalg.norm(error, axis=1) < OUTLYING * sigma
    weight = 1 / sigma.astype(np.float64) ** 2
    return np.stack(
        [np.average(error[of], axis=0, weights=weight[of]) for of in (kept & (label == face) for face in range(3))]
    )


def show(name: str, of_rooms: Sequence[Floats]) -> None:
    last = "  ".join(f"{1000 * x:+5.1f} {1000 * y:+5.1f}" for x, y in of_rooms[-1])
    print(f"  {name:36} {1000 * np.sqrt(np.mean(np.square(of_rooms))):5.2f}   {last}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--sequence", default="standard")
    parser.add_argument("--exposure", type=float, default=1.0, help="next to the one that suits the room")
    parser.add_argument("--under", type=json.loads, default={}, help="further settings of the rig, as JSON")
    options = parser.parse_args()
    print(f"thousandths of a projector pixel: rms; {', '.join(FACES)} of the last room, along x and y")
    for name, widths in WIDTHS.items():
        found: dict[str, list[Floats]] = {}
        for seed in options.seeds:
            room = room_of(SimulatedRigSettings(seed=seed, furniture_askew_deg=2.0, **options.under), widths)
            capture = take(room, patterns_of(options.sequence, PROJECTOR), options.exposure)
            truth = room.ground_truth()
            for variant, names in SWITCHED_OFF.items():
                with switched_off(names):
                    found.setdefault(variant, []).append(means(decoded(capture), truth))
            peer = plain_matches(capture.patterns, capture.frames)
            found.setdefault("peer", []).append(means(peer, truth))
        print(f"{name} projector")
        for variant, of_rooms in found.items():
            show(variant, of_rooms)


if __name__ == "__main__":
    main()
