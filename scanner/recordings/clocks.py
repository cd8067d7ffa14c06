"""The clocks of an unsynchronised projector and camera, from the frames; the start marks in them tell when a loop
begins.

Row r of frame n is exposed for E from t_n + (r − r_m) L − E / 2 on: t_n is the frame's time, r_m the middle row, L the
line time, E the exposure. The picture changes at b + j T, in the camera's time. So of two pictures, the share of the
later one is (time exposed after the change) / E in every row, which the light shows (Moreno, Calakli and Taubin,
SIGGRAPH Asia 2015, use the same with binary pictures).
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NoReturn

import numpy as np

from calib.finding import Finding, FindingKind, Severity
from calib.numerics import Floats
from scanner.errors import InputError
from scanner.recordings.programme import WHITE, Programme
from scanner.recordings.samples import VideoSamples
from scanner.recordings.video_file import ToneCurve

# Speed ratios of players, likeliest first: 25 for 24 frames a second, for example.
_RATES = sorted(np.linspace(0.95, 1.05, 11), key=lambda rate: abs(rate - 1))
_SLOW_MOTION = (2, 4, 8)
_CERTAIN = 0.93
_STEPS_PER_SLOT = 8
_LEAST_CORRELATION = 0.85
_LEAST_SWING = 0.5  # share of the full range of brightness
_FEWEST_FRAMES_PER_SLOT, _GOOD_FRAMES_PER_SLOT = 1.5, 2.5
_MOST_STRETCH = 0.012  # relative deviation of a loop: a few frames were dropped or repeated

FEW_FRAMES = FindingKind(
    "few-frames",
    "A film has so few frames for each picture that they hardly determine the clocks.",
    "Write the video with a longer --hold, or film with more frames a second.",
)
LOOP_LEFT_OUT = FindingKind(
    "loop-left-out",
    "A loop of the filmed video is left out, for it was too short or too long.",
    "Play the video from beginning to end without a pause, and film all of it.",
    ("begin_s", "length_s", "expected_s"),
)
_ALIKE = 1.2  # ratio of exposures that are one


@dataclass(frozen=True)
class Loop:
    """A loop from a start mark at `start_s` to the end of the next mark; slots of `slot_s`, in the camera's time."""

    start_s: float
    slot_s: float


@dataclass(frozen=True)
class FoundLoops:
    """The filmed loops, and `findings` on those that are left out."""

    loops: tuple[Loop, ...]
    findings: tuple[Finding, ...]


def find_loops(samples: VideoSamples, programme: Programme) -> FoundLoops:
    """The filmed loops from mark to mark. Raises InputError without any."""
    path = samples.video.path
    if programme.hold_s / samples.frame_interval_s < _FEWEST_FRAMES_PER_SLOT:
        raise InputError(
            f"{path}: {1 / samples.frame_interval_s:.1f} frames a second are too few for pictures of "
            f"{programme.hold_s:.3f} s: film with more, or write the video with a longer --hold"
        )
    brightness = _brightness(samples)
    starts, rate = _found(samples.times_s, brightness, programme.mark, programme.hold_s)
    if not starts:
        _refuse(samples, brightness, programme)
    if len(starts) < 2:
        raise InputError(
            f"{path}: one start mark was filmed, at {starts[0]:.1f} s, where a loop lies between two: "
            "film from before the video begins until it stays black, or write the video with more --loops"
        )
    loops, findings = list[Loop](), list[Finding]()
    if programme.hold_s / samples.frame_interval_s < _GOOD_FRAMES_PER_SLOT:
        message = "So few frames per picture hardly determine the clocks: a longer --hold makes the capture better."
        findings.append(Finding(FEW_FRAMES, Severity.NOTE, message))
    expected = programme.slots_between_marks * programme.hold_s * rate
    for first, second in pairwise(starts):
        if abs((second - first) / expected - 1) < _MOST_STRETCH:
            loops.append(Loop(first, (second - first) / programme.slots_between_marks))
        else:
            message = (
                f"The loop from {first:.1f} s on took {second - first:.2f} s, where {expected:.2f} s were expected: "
                "it is left out; the player paused or skipped, or the recording was cut."
            )
            lengths = {"begin_s": first, "length_s": second - first, "expected_s": expected}
            findings.append(Finding(LOOP_LEFT_OUT, Severity.WARNING, message, data=lengths))
    if not loops:
        raise InputError(f"{path}: {findings[-1]} Play the video from beginning to end, and film all of it")
    return FoundLoops(tuple(loops), tuple(findings))


def _brightness(samples: VideoSamples) -> Floats:
    """(N,): of the rows in the middle, which are exposed at about the same time, from −1 (black) to 1."""
    lit = samples.lit
    by_row = lit.sum(axis=1)
    centre = int(np.average(np.arange(len(by_row)), weights=by_row))
    rows = slice(max(0, centre - 3), centre + 4)
    levels = samples.codes[:, rows][:, lit[rows]].mean(axis=1)
    low, high = np.percentile(levels, (1, 99))
    relative: Floats = 2 * (levels - low) / max(high - low, 1e-6) - 1
    return relative


def _found(times: Floats, brightness: Floats, mark: tuple[int, ...], hold_s: float) -> tuple[list[float], float]:
    """Return the beginnings of the marks, in order, and the ratio of the clocks, one of `_RATES`, the same for all
    marks.
    """
    best, best_rate = list[tuple[float, float]](), 1.0
    for rate in _RATES:
        marks = _at_rate(times, brightness, mark, hold_s * float(rate))
        if sum(score for _, score in marks) > sum(score for _, score in best):
            best, best_rate = marks, float(rate)
        if best and all(score > _CERTAIN for _, score in best):
            break
    return [start for start, _ in best], best_rate


def _at_rate(times: Floats, brightness: Floats, mark: tuple[int, ...], slot_s: float) -> list[tuple[float, float]]:
    """(beginning, correlation) of the marks, in order."""
    code = np.array([1.0 if field == WHITE else -1.0 for field in mark])
    length = len(code) * slot_s
    starts = np.arange(times[0], times[-1] - length + slot_s / 2, slot_s / _STEPS_PER_SLOT)
    scores = np.array([_score(times, brightness, code, slot_s, start) for start in starts])
    marks: list[tuple[float, float]] = []
    while scores.size and scores.max() > _LEAST_CORRELATION:
        best = int(scores.argmax())
        # The middle of all neighbouring starts that fit equally well.
        near = np.flatnonzero((np.abs(starts - starts[best]) < slot_s) & (scores > scores[best] - 0.02))
        marks.append((float(starts[near].mean()), float(scores[best])))
        scores = np.where(np.abs(starts - starts[best]) < length, 0.0, scores)
    return sorted(marks)


def _score(times: Floats, brightness: Floats, code: Floats, slot_s: float, start: float) -> float:
    """Correlation of the brightness with the code, 0 where it does not swing."""
    first, last = np.searchsorted(times, (start, start + len(code) * slot_s))
    window = brightness[first:last]
    if len(window) < len(code):
        return 0.0
    slots = np.clip(((times[first:last] - start) / slot_s).astype(np.intp), 0, len(code) - 1)
    expected = code[slots]
    if np.ptp(expected) == 0 or np.std(window) < _LEAST_SWING:
        return 0.0
    return float(np.corrcoef(window, expected)[0, 1])


def _refuse(samples: VideoSamples, brightness: Floats, programme: Programme) -> NoReturn:
    """Raise InputError for a recording without the sequence's mark."""
    rhythm = programme.mark[: programme.rhythm_slots]
    other_marks, _ = _found(samples.times_s, brightness, rhythm, programme.hold_s)
    length = samples.times_s[-1] - samples.times_s[0]
    path = samples.video.path
    if other_marks and length > len(programme.loop) * programme.hold_s / 2:
        raise InputError(
            f"{path}: the start mark at {other_marks[0]:.1f} s is not that of this sequence: "
            "give the sequence.yaml that was written with the video that was shown"
        )
    for slower in _SLOW_MOTION:
        if _found(samples.times_s, brightness, programme.mark, slower * programme.hold_s)[0]:
            raise InputError(
                f"{path}: is in slow motion, {slower} times slower than the video was shown: film at normal speed, "
                "at any number of frames a second"
            )
    raise InputError(
        f"{path}: no start mark was found in {length:.1f} s: expected a film of the video from its black beginning to "
        "its black end, by a camera that stands still with its exposure locked"
    )


@dataclass(frozen=True)
class Clocks:
    """When rows of the camera are exposed, and when the pictures change."""

    exposure_s: float
    line_s: float  # from one row to the next
    loops: tuple[Loop, ...]  # with refined starts and slots
    shifts_s: tuple[Floats, ...]  # (slots + 1,) for each loop: the delays of its changes
    tone: ToneCurve
    scatter_s: float  # root mean square of the changes' residuals
    exposures_s: tuple[float, float]  # least and greatest exposure, with a readout in proportion, that are as likely

    def changes(self, number: int) -> Floats:
        """Return when the slots of a loop begin, and the last one ends, (slots + 1,) in the camera's time."""
        loop, shifts = self.loops[number], self.shifts_s[number]
        return loop.start_s + loop.slot_s * np.arange(len(shifts)) + shifts

    @property
    def has_exposure(self) -> bool:
        """Whether the film determines exposure and readout."""
        least, greatest = self.exposures_s
        return greatest < _ALIKE * least

    @property
    def every_change(self) -> Floats:
        """Changes of all loops in order, (loops · (slots + 1),)."""
        return np.concatenate([self.changes(number) for number in range(len(self.loops))])

    def row_delays(self, rows: Floats, middle_row: float) -> Floats:
        """Return the delay of rows relative to the middle row, in seconds."""
        return (rows - middle_row) * self.line_s


def exposure_text(clocks: Clocks) -> str:
    """The exposure for people, as 16.7 ms or 'from 1.0 to 17.2 ms'."""
    if clocks.has_exposure:
        return f"{1e3 * clocks.exposure_s:.1f} ms"
    return "from {:.1f} to {:.1f} ms".format(*(1e3 * exposure_s for exposure_s in clocks.exposures_s))
