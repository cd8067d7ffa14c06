"""Outcomes of captures of simulated rooms during which a device is bumped, drifts, or rests.

    python benchmarks/bench_motion.py --captures 500 --rooms 0 1 2 3 4
    python benchmarks/bench_motion.py --captures 200 --rooms 0 1 2 3 4 --rest 1
    python benchmarks/bench_motion.py --captures 500 --jobs 2 --results motion.jsonl    continues the file
    python benchmarks/bench_motion.py --captures 500 --rooms 0 1 2 3 4 --numbers 366    repeats some of them

Bumps of 0.1 to 10 px of either device in any direction at any frame, drifts of the same size over the capture, some at
rest; all presets in sequence, and their patterns in the order of other programs, which show all along x before all
along y ('apart'). A few captures with independent noise share each rotation of a device, which is slow to simulate; it
happens at a different frame of each. 'wrong': an answer beyond 4 of its sigmas or 2 % (the mean of the four
intrinsics); 'weak': beyond 2 %, but within 4 sigmas of more than 1 %, so that the report says 'for a first look';
'doubtful': wrong, but with the note that the frames cannot reveal motion.
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import groupby, repeat
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from calib.geometry import Calibration, Size
from calib.numerics import Image
from calib.refusal import RefusalError
from hw.settings import SimulatedRigSettings
from hw.simulated import Light, SimulatedRoom
from scanner.capture import CaptureMetadata
from scanner.configuration import Config
from scanner.decoding import Decoder
from scanner.errors import InputError
from scanner.patterns import PRESETS, Pattern, Phase, PresetName, draw
from scanner.quantities import intrinsic_errors_percent
from scanner.reconstruction import calibrate, label
from scanner.results import Decoded

CAMERA, PROJECTOR = Size(612, 512), Size(854, 480)
_SIGMAS, _PERCENT, _GRADE_PERCENT = 4.0, 2.0, 1.0
_SMALLEST_PX, _LARGEST_PX = 0.1, 10.0


@dataclass(frozen=True)
class Case:
    """The motion during a capture; `apart`: all patterns along x come before all along y."""

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

    @property
    def turn(self) -> dict[str, object]:
        """The rotation of the device, as settings of the simulated rig."""
        return {"device": self.device, "direction_deg": self.direction_deg}


def patterns_of(preset: PresetName, *, apart: bool) -> tuple[Pattern, ...]:
    """The sequence of a preset, or all its patterns along x before all along y."""
    patterns = PRESETS[preset].patterns(PROJECTOR)
    if not apart:
        return patterns

    def place(pattern: Pattern) -> tuple[object, ...]:
        fringe = (pattern.period, -pattern.shift) if isinstance(pattern, Phase) else (np.inf, 0.0)
        return getattr(pattern, "axis", ""), *(-part for part in fringe)

    return tuple(sorted(patterns, key=place))


def cases(options: argparse.Namespace) -> Iterator[Case]:
    """Random cases, grouped by room and preset."""
    rng = np.random.default_rng(options.seed)
    groups = [(room, preset) for room in options.rooms for preset in options.presets]
    for number, (room, preset) in enumerate(groups):
        frames = len(PRESETS[preset].patterns(PROJECTOR))
        count = options.captures * (number + 1) // len(groups) - options.captures * number // len(groups)
        drifts = min(options.drifts, 1 - options.rest)
        kinds = rng.choice(["rest", "bump", "drift"], size=count, p=[options.rest, 1 - options.rest - drifts, drifts])
        for place, kind in enumerate(sorted(kinds)):
            if place % options.per_turn == 0:
                device = str(rng.choice(["camera", "projector"]))
                px = float(np.exp(rng.uniform(np.log(_SMALLEST_PX), np.log(_LARGEST_PX))))
                direction_deg = float(rng.uniform(0, 360))
            apart = bool(rng.random() < options.apart)
            frame, noise = int(rng.integers(1, frames)), int(rng.integers(1 << 30))
            yield Case(room, preset, apart, str(kind), device, px, direction_deg, frame, noise)


class Footage:
    """Expected camera views of patterns in a room, at rest and after the latest rotation of a device."""

    def __init__(self, room: SimulatedRoom) -> None:
        self.room = room
        self._rest: dict[Pattern, Light] = {}
        self._turned: dict[Pattern, Light] = {}
        self._turn: dict[str, object] = {}
        self._view = room.renderer

    def frames(self, case: Case, patterns: Sequence[Pattern]) -> Iterator[Image]:
        """The frames of a capture."""
        noise = np.random.default_rng(case.noise)
        for number, pattern in enumerate(patterns):
            px = case.px * number / len(patterns) if case.kind == "drift" else case.px
            rests = case.kind == "rest" or (case.kind == "bump" and number < case.frame)
            yield self.room.sensor.read(
                self._at_rest(pattern) if rests else self._after(case.turn | {"px": px}, pattern), noise
            )

    def _at_rest(self, pattern: Pattern) -> Light:
        if pattern not in self._rest:
            self._rest[pattern] = self.room.electrons(draw(pattern, PROJECTOR))
        return self._rest[pattern]

    def _after(self, turn: dict[str, object], pattern: Pattern) -> Light:
        if turn != self._turn:
            self._turn, self._turned, self._view = turn, {}, self.room.under(bump=turn).at(0)
        if pattern not in self._turned:
            self._turned[pattern] = self.room.sensor.electrons(self._view.render(draw(pattern, PROJECTOR)))
        return self._turned[pattern]


def run(case: Case, footage: Footage) -> tuple[str, str]:
    """Run a case; returns its outcome with its figures."""
    patterns = patterns_of(case.preset, apart=case.apart)
    decoder = Decoder(patterns, PROJECTOR)
    truth = footage.room.calibration
    if truth is None:
        raise ValueError("a room whose picture is keystoned has no calibration to compare with")
    config = Config.model_validate({"camera": {"principal_point": {"known": truth.camera.principal_point_px}}})
    try:
        for frame in footage.frames(case, patterns):
            decoder.add(frame)
        decoding = decoder.finish()
        found = Decoded(CaptureMetadata(CAMERA, PROJECTOR, patterns), decoding.matches, decoding)
        (calibrated,) = calibrate(label([found], [found], config), config)
    except (RefusalError, InputError) as error:
        kind = "refused" if isinstance(error, RefusalError) else "input error"
        return f"{kind}, motion" if "moved" in str(error) else kind, str(error)[:110]
    (percent, sigmas), sigma_percent = errors(calibrated.calibration, truth), sigma_of(calibrated.calibration)
    motion, solution = decoding.motion, calibrated.solution
    seen = f"; {motion}" if motion is not None and motion.is_significant else ""
    figures = (
        f"{percent:.2f} %, {sigmas:.1f} sigma, by motion {solution.likely_percent:.2f} %, "
        f"unseen {solution.possible_percent:.2f} %, sigma {sigma_percent:.2f} %{seen}"
    )
    if sigmas > _SIGMAS or percent > _PERCENT:
        if motion is not None and motion.is_blind:
            return "doubtful", figures
        return "weak" if sigmas <= _SIGMAS and sigma_percent > _GRADE_PERCENT else "wrong", figures
    return "seen" if seen else "good", figures


def sigma_of(found: Calibration) -> float:
    """The larger sigma of the two focal lengths, in per cent."""
    devices = ((found.camera, found.sigma.camera), (found.projector, found.sigma.projector))
    return max(100 * float(np.max(sigma.focal_px)) / device.focal_px[0] for device, sigma in devices)


def errors(found: Calibration, truth: Calibration) -> tuple[float, float]:
    """Errors of the intrinsics: the mean in per cent, and the largest in sigmas."""
    sigmas = []
    for device in ("camera", "projector"):
        error = abs(getattr(found, device).focal_px[0] - getattr(truth, device).focal_px[0])
        sigmas.append(error / np.max(getattr(found.sigma, device).focal_px))
    return float(np.mean(np.abs(intrinsic_errors_percent(found, truth)))), float(max(sigmas))


@dataclass(frozen=True)
class Row:
    """The outcome of a case."""

    case: Case
    outcome: str
    figures: str

    def __str__(self) -> str:
        return f"{self.outcome:16} {self.case}: {self.figures}"


def run_all(cases: Sequence[Case], results: Path | None) -> list[Row]:
    """Run the cases of one room in order; each is printed, and written to `results`, once it is known."""
    room = SimulatedRoom(SimulatedRigSettings(seed=cases[0].room), CAMERA, PROJECTOR)
    footage, rows = Footage(room), []
    for case in cases:
        row = Row(case, *run(case, footage))
        rows.append(row)
        print(f"{row}\n", end="", flush=True)  # one write, because processes share the terminal
        if results:
            with results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(row)) + "\n")
    return rows


def earlier(results: Path | None) -> dict[Case, Row]:
    """The outcomes in a file of results."""
    if results is None or not results.exists():
        return {}
    found = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
    rows = [Row(Case(**row["case"]), row["outcome"], row["figures"]) for row in found]
    return {row.case: row for row in rows}


def totals(rows: Sequence[Row]) -> Iterator[str]:
    """Counts of outcomes by kind of motion, one line each."""
    counts: Counter[tuple[str, str, str]] = Counter()
    for row in rows:
        case = row.case
        order = "apart" if case.apart else "nested"
        size = "" if case.kind == "rest" else "< 0.5 px" if case.px < 0.5 else "< 2 px" if case.px < 2 else "≥ 2 px"
        counts[order, f"{case.kind} {size}", row.outcome] += 1
    for (order, kind, outcome), count in sorted(counts.items()):
        yield f"{order:7} {kind:16} {outcome:20} {count}"


def main() -> None:
    options = _options()
    wanted = list(cases(options))
    if options.numbers:
        if not all(0 <= number < len(wanted) for number in options.numbers):
            raise SystemExit(f"--numbers: expected from 0 to {len(wanted) - 1}, found {max(options.numbers)}")
        wanted = [wanted[number] for number in options.numbers]
    known = earlier(options.results)
    rows = [known[case] for case in wanted if case in known]
    # Each process runs one room and preset, because its views at rest are slow to simulate.
    groups = groupby((case for case in wanted if case not in known), key=lambda case: (case.room, case.preset))
    tasks = [tuple(group) for _, group in groups]
    # Workers are started, not forked, because threads of a library do not survive a fork.
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
        for found in pool.map(run_all, tasks, repeat(options.results)):
            rows.extend(found)
    print("\n".join(totals(rows)))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=int, default=60)
    parser.add_argument("--rooms", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--presets", nargs="+", default=list(PRESETS))
    parser.add_argument("--apart", type=float, default=0.2, help="share of captures with all x before all y")
    parser.add_argument("--rest", type=float, default=0.2, help="share of captures at rest")
    parser.add_argument("--drifts", type=float, default=0.05, help="share of drifts, which take long to simulate")
    parser.add_argument("--per-turn", type=int, default=4, help="captures that share a turn of a device")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--numbers", type=int, nargs="+", help="of the captures, these only, from 0 on")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--results", type=Path, metavar="FILE", help="keep outcomes here, and go on where it ends")
    return parser.parse_args()


if __name__ == "__main__":
    main()
