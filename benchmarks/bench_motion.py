"""Captures of simulated rooms during which a device is knocked against, drifts, or rests: what becomes of them.

    python benchmarks/bench_motion.py --captures 500 --rooms 0 1 2 3 4

Bumps of 0.1 to 10 px of either device in any direction at any frame, drifts as far over the capture, one in five at
rest; all presets in turn, and their patterns in the order of other programs, which show all along x before all along y
('apart'). 'wrong': an answer beyond 4 of its sigmas or 2 % (the mean of the four intrinsics). 'doubtful': wrong, but
with the note that motion could not be excluded.
"""

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from calib.geometry import Calibration, Size
from calib.refusal import RefusalError
from hw.settings import SimulatedRigSettings
from hw.simulated.rig import SimulatedCamera, SimulatedProjector
from hw.simulated.simulation import SimulatedRoom
from scanner.capture import CaptureFacts
from scanner.configuration import Config
from scanner.decoding import Decoder
from scanner.errors import InputError
from scanner.patterns import PRESETS, Pattern, Phase, PresetName, draw
from scanner.quantities import intrinsic_errors_percent
from scanner.reconstruction import calibrate, label
from scanner.results import Decoded

CAMERA, PROJECTOR = Size(612, 512), Size(854, 480)
_SIGMAS, _PERCENT = 4.0, 2.0
_SMALLEST_PX, _LARGEST_PX = 0.1, 10.0


@dataclass(frozen=True)
class Case:
    """What happens during a capture; `apart`: all patterns along x come before all along y."""

    room: int
    preset: PresetName
    apart: bool
    kind: str
    device: str
    px: float
    direction_deg: float
    frame: int
    noise: int

    def __str__(self) -> str:
        order = "apart" if self.apart else "nested"
        what = (
            self.kind
            if self.kind == "rest"
            else f"{self.kind} {self.device} {self.px:.2f} px {self.direction_deg:.0f}°"
        )
        return f"room {self.room} {self.preset} {order} {what}{f' @{self.frame}' if self.kind == 'bump' else ''}"

    def settings(self, frames: int) -> dict[str, object]:
        """Of the simulated rig."""
        moving = {"device": self.device, "direction_deg": self.direction_deg}
        if self.kind == "bump":
            return {"bump": moving | {"frame": self.frame, "px": self.px}}
        if self.kind == "drift":
            return {"drift": moving | {"px_per_frame": self.px / frames}}
        return {}


def patterns_of(preset: PresetName, *, apart: bool) -> tuple[Pattern, ...]:
    """The sequence of a preset, or all its patterns along x before all along y."""
    patterns = PRESETS[preset].patterns(PROJECTOR)
    if not apart:
        return patterns

    def place(pattern: Pattern) -> tuple[object, ...]:
        fringe = (pattern.period, -pattern.shift) if isinstance(pattern, Phase) else (np.inf, 0.0)
        return getattr(pattern, "axis", ""), *(-part for part in fringe)

    return tuple(sorted(patterns, key=place))


def cases(
    count: int, rooms: list[int], presets: list[PresetName], seed: int, apart_share: float, drifts: float
) -> Iterator[Case]:
    """Drawn at random."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        preset = presets[number % len(presets)]
        frames = len(PRESETS[preset].patterns(PROJECTOR))
        yield Case(
            rooms[number * len(rooms) // count],
            preset,
            bool(rng.random() < apart_share),
            str(rng.choice(["rest", "bump", "drift"], p=[0.2, 1 - 0.2 - drifts, drifts])),
            str(rng.choice(["camera", "projector"])),
            float(np.exp(rng.uniform(np.log(_SMALLEST_PX), np.log(_LARGEST_PX)))),
            float(rng.uniform(0, 360)),
            int(rng.integers(1, frames)),
            int(rng.integers(1 << 30)),
        )


def run(case: Case, room: SimulatedRoom) -> tuple[str, str]:
    """What became of it, and figures."""
    patterns = patterns_of(case.preset, apart=case.apart)
    moving = room.under(**case.settings(len(patterns)))
    projector = SimulatedProjector(moving)
    camera = SimulatedCamera(moving, projector)
    camera._noise = np.random.default_rng(case.noise)  # every capture its own
    decoder = Decoder(patterns, PROJECTOR)
    for pattern in patterns:
        projector.show(draw(pattern, PROJECTOR))
        decoder.add(camera.grab().image)
    known = room.calibration.camera.principal_point_px
    config = Config.model_validate({"camera": {"principal_point": {"known": known}}})
    try:
        decoding = decoder.finish()
        found = Decoded(CaptureFacts(CAMERA, PROJECTOR, patterns), decoding.matches, decoding)
        (calibrated,) = calibrate(label([found], [found]), config)
    except (RefusalError, InputError) as error:
        kind = "refused" if isinstance(error, RefusalError) else "input error"
        return f"{kind}, motion" if "moved by" in str(error) else kind, str(error)[:110]
    percent, sigmas = errors(calibrated.calibration, room.calibration)
    motion = decoding.motion
    solution = calibrated.solution
    seen = f"; {motion}" if motion is not None and motion.significant else ""
    doubt = solution.possible_percent
    figures = f"{percent:.2f} %, {sigmas:.1f} sigma, by motion {solution.likely_percent:.2f} %, doubt {doubt:.1f}{seen}"
    wrong = percent > _PERCENT or sigmas > _SIGMAS
    return ("doubtful" if wrong and doubt else "wrong" if wrong else "seen" if seen else "good"), figures


def errors(found: Calibration, truth: Calibration) -> tuple[float, float]:
    """Of the intrinsics: the mean error in per cent, and the worst in sigmas."""
    sigmas = []
    for device in ("camera", "projector"):
        error = abs(getattr(found, device).focal_px[0] - getattr(truth, device).focal_px[0])
        sigmas.append(error / np.max(getattr(found.sigma, device).focal_px))
    return float(np.mean(np.abs(intrinsic_errors_percent(found, truth)))), float(max(sigmas))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=int, default=60)
    parser.add_argument("--rooms", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--presets", nargs="+", default=list(PRESETS))
    parser.add_argument(
        "--apart", type=float, default=0.2, help="share of captures with all along x before all along y"
    )
    parser.add_argument("--drifts", type=float, default=0.2, help="share of drifts, which take long to simulate")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    outcomes: Counter[tuple[str, str, str]] = Counter()
    room: SimulatedRoom | None = None
    for case in cases(options.captures, options.rooms, options.presets, options.seed, options.apart, options.drifts):
        if room is None or room.settings.seed != case.room:
            room = SimulatedRoom(SimulatedRigSettings(seed=case.room), CAMERA, PROJECTOR)
        outcome, figures = run(case, room)
        order = "apart" if case.apart else "nested"
        size = "" if case.kind == "rest" else "< 0.5 px" if case.px < 0.5 else "< 2 px" if case.px < 2 else "≥ 2 px"
        outcomes[order, f"{case.kind} {size}", outcome] += 1
        print(f"{outcome:16} {case}: {figures}", flush=True)
    for (order, kind, outcome), count in sorted(outcomes.items()):
        print(f"{order:7} {kind:16} {outcome:20} {count}")


if __name__ == "__main__":
    main()
