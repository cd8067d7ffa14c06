"""A quick capture: how much of the light the camera sees, and what this view of a corner will calibrate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnostics import FURTHER_CAPTURE, USEFUL_SIGMA
from calib.finding import Finding, FindingKind, Severity, of_kinds
from calib.numerics import Bools, Floats
from calib.refusal import RIG, RefusalError
from calib.self_calibration import SelfCalibration
from hw.rig import Rig
from scanner.acquisition import decode
from scanner.capture import capture
from scanner.checking.fringes import FringeMeter
from scanner.checking.report import LEAST_SHARE, CheckRow
from scanner.configuration import Config
from scanner.decoding import Decoding, MaskReason, MirroredError
from scanner.errors import FramesError, InputError
from scanner.patterns import PRESETS, Pattern, Preset, PresetName
from scanner.quantities import relative_focal_sigmas
from scanner.reconstruction import label, solve
from scanner.results import Decoded
from scanner.shown_text import capitalised
from scanner.ui import Progress

_QUICK: PresetName = "quick"
_VIEW, _COVERAGE = "view", "coverage"
# The quick capture predicts the scan's sigma within a factor of two: beyond half the limit, a scan may be refused.
_RISKY_SIGMA = USEFUL_SIGMA / 2
# Number of squares across the projector's picture; a square without matches is not seen.
_SQUARES_ACROSS = 32
# Share of the camera's pixels, a quarter of its width and height: below, lens terms and principal point, which show far
# from the centre, are not determined.
_LEAST_OF_CAMERA = 1 / 16
# Offset from the centre, as a share of the picture's side, that gives a direction to turn.
_OFF_CENTRE = 0.05
# Stripes that survive a blur of several pixels, unlike the quick ones.
_COARSE = Preset("gray", cell=16, inverses=True, periods=(32.7,), shifts=4)
_UNREADABLE = "Correct what the lines above say about light and focus, keep the scene still, and check again."
_MIRRORED = "Switch off rear projection, or ceiling mount, in its menu; do not photograph its picture in a mirror."

CHECKED_COVERAGE = FindingKind(
    "check-coverage",
    "What scan check says of how much of both pictures overlaps.",
    "Turn the devices, or change distance or lens, as the message says.",
)
CHECKED_VIEW = FindingKind(
    "check-view",
    "What scan check says of how well this view will calibrate the rig, or why it would be refused.",
    "Move the rig as the message says.",
)


@dataclass(frozen=True)
class Capture:
    """The outcome of a sequence. If its frames do not decode, `decoded` is None, `problem` gives the reason and
    `advice` the remedy.
    """

    decoded: Decoded | None
    problem: str = ""
    advice: str = ""

    @property
    def is_patchy(self) -> bool:
        """Half of the lit pixels or more did not decode."""
        return self.decoding is None or decoded_share(self.decoding) < LEAST_SHARE

    @property
    def decoding(self) -> Decoding | None:
        """What was decoded."""
        return self.decoded.decoding if self.decoded else None


def take_quick(rig: Rig, config: Config, meter: FringeMeter, terminal: Progress) -> Capture:
    """Capture the quick sequence while `meter` looks on. Raises DeviceError."""
    patterns = PRESETS[_QUICK].patterns(rig.projector.size)
    return _take(rig, config, patterns, meter, terminal, "Capturing quickly")


def take_configured(rig: Rig, config: Config, terminal: Progress) -> Capture | None:
    """Capture the sequence of a scan; None if that is the quick sequence. Raises DeviceError."""
    patterns = config.sequence.patterns(rig.projector.size)
    if patterns == PRESETS[_QUICK].patterns(rig.projector.size):
        return None
    return _take(rig, config, patterns, FringeMeter(), terminal, "Capturing as a scan would")


def take_coarse(rig: Rig, config: Config, terminal: Progress) -> Capture:
    """Capture a sequence that blur does less to, to learn at least which pixels see which. Raises DeviceError."""
    patterns = _COARSE.patterns(rig.projector.size)
    return _take(rig, config, patterns, FringeMeter(), terminal, "Capturing coarsely")


def _take(
    rig: Rig,
    config: Config,
    patterns: tuple[Pattern, ...],
    meter: FringeMeter,
    terminal: Progress,
    what: str,
) -> Capture:
    stream = capture(rig, patterns, response=config.projector.known_response)
    watched = replace(stream, frames=meter.watch(stream.frames))
    try:
        (decoded,) = decode([watched], terminal, what)
        return Capture(decoded)
    except MirroredError:
        return Capture(None, "the projector mirrors its picture", _MIRRORED)
    except InputError as error:
        problem = error.problem if isinstance(error, FramesError) else error
        return Capture(None, f"the frames do not decode: {problem}", _UNREADABLE)


def projector_map(decoding: Decoding) -> Floats:
    """The projector pixel (H, W, 2) that each camera pixel sees, NaN where none is known."""
    coordinates = np.full((*decoding.reasons.shape, 2), np.nan)
    column, row = np.rint(decoding.matches.camera_px).astype(np.int64).T
    coordinates[row, column] = decoding.matches.projector_px
    return coordinates


@dataclass(frozen=True)
class PictureCoverage:
    """How much of either picture serves, and where the served part has its middle, −½ … ½ from the centre, x and y.

    `camera`: share of the camera's pixels that have a match; `projector`: share of the projector's light that the
    camera sees. `seen`: (rows, columns), the squares of the projector's picture that it sees. `span`: projector pixels
    per camera pixel, on average.
    """

    camera: float
    camera_middle: tuple[float, float]
    projector: float
    projector_middle: tuple[float, float]
    seen: Bools
    span: float


def coverage_of(decoding: Decoding, projector_size: tuple[int, int]) -> PictureCoverage:
    """Compute the coverage from the matches of a capture; without one, the middles are the centres."""
    height, width = decoding.reasons.shape
    across = _SQUARES_ACROSS
    down = max(1, round(across * projector_size[1] / projector_size[0]))
    position = (decoding.matches.projector_px + 0.5) / np.array(projector_size)
    column, row = (position * (across, down)).astype(np.int64).clip(0, (across - 1, down - 1)).T
    tiles = np.zeros((down, across), np.bool_)
    tiles[row, column] = True
    camera_places = (decoding.matches.camera_px + 0.5) / (width, height)
    tile_places = (np.argwhere(tiles)[:, ::-1] + 0.5) / (across, down)
    spanned = tiles.mean() * projector_size[0] * projector_size[1] / max(1, len(decoding.matches))
    return PictureCoverage(
        float(np.mean(decoding.reasons == MaskReason.KEPT)),
        _from_centre(camera_places),
        float(tiles.mean()),
        _from_centre(tile_places),
        tiles,
        float(np.sqrt(spanned)),
    )


def _from_centre(places: Floats) -> tuple[float, float]:
    """The middle of places (N, 2), from 0 to 1 across a picture, from the picture's centre."""
    x, y = places.mean(axis=0) - 0.5 if len(places) else (0.0, 0.0)
    return float(x), float(y)


def decoded_share(decoding: Decoding) -> float:
    """Return the share of lit pixels that have a match; 1 if none is lit."""
    lit = int(np.sum(decoding.reasons != MaskReason.DARK))
    return float(np.sum(decoding.reasons == MaskReason.KEPT)) / lit if lit else 1.0


def coverage_row(coverage: PictureCoverage, decoding: Decoding) -> CheckRow:
    """Grade the overlap of the two pictures, with directions to turn the devices."""
    finding = (
        f"{100 * coverage.camera:.0f} % of the camera's pixels see the projector's light, and the camera sees "
        f"{100 * coverage.projector:.0f} % of it"
    )
    if decoded_share(decoding) < LEAST_SHARE:
        finding += f"; only {100 * decoded_share(decoding):.0f} % of the lit pixels decode"
        return CheckRow(
            _COVERAGE,
            Finding(
                CHECKED_COVERAGE, Severity.WARNING, finding, "Correct what the other lines say about light and focus."
            ),
        )
    advice = []
    if coverage.camera < _LEAST_OF_CAMERA:
        advice.append(_turned("the camera", coverage.camera_middle, "Move the camera closer, or use a longer lens"))
    if coverage.projector < LEAST_SHARE:
        advice.append(_turned("the projector", coverage.projector_middle, "Move the camera back, or use a wider lens"))
    return CheckRow(
        _COVERAGE, Finding(CHECKED_COVERAGE, Severity.WARNING if advice else Severity.NOTE, finding, " ".join(advice))
    )


def _turned(device: str, middle: tuple[float, float], otherwise: str) -> str:
    """Direction in which to turn the device so that the common view is in the middle of its picture."""
    ways = []
    for offset, (less, more) in zip(middle, (("left", "right"), ("up", "down")), strict=True):
        if abs(offset) > _OFF_CENTRE:
            ways.append(more if offset > 0 else less)
    if not ways:
        return f"{otherwise}."
    return f"Turn {device} to the {' and '.join(ways)}, as seen from behind it.".replace("to the up", "up").replace(
        "to the down", "down"
    )


def predict(decoded: Decoded, config: Config, earlier: Sequence[Decoded]) -> SelfCalibration:
    """Predict the calibration from a capture, together with earlier ones if there are any. Raises RefusalError."""
    captures = [*earlier, decoded]
    return solve(label(captures, [*captures], config), config.model_copy(update={"method": "refined"}))[-1]


def view_row(
    capture: Capture, config: Config, earlier: Sequence[Decoded], *, as_configured: bool = False
) -> tuple[CheckRow, RefusalError | None]:
    """Predict the accuracy of a calibration from this view, or the reason of a refusal.

    `as_configured`: `seen` is not the quick capture, which decoded too little.
    """
    if capture.decoded is None:
        row = CheckRow(_VIEW, Finding(CHECKED_VIEW, Severity.REFUSAL, capture.problem, capture.advice))
        return row, refusal_of(row)
    try:
        solution = predict(capture.decoded, config, earlier)
    except RefusalError as refusal:
        return CheckRow(_VIEW, Finding(CHECKED_VIEW, Severity.REFUSAL, refusal.reason, refusal.advice)), refusal
    sigmas = relative_focal_sigmas(solution.calibration)
    described = " and ".join(f"{100 * sigma:.2g} % ({device})" for device, sigma in sigmas.items())
    finding = f"focal lengths will be known to about {described}"
    if max(sigmas.values()) > _RISKY_SIGMA:
        further = of_kinds(solution.findings, FURTHER_CAPTURE)
        return CheckRow(
            _VIEW, Finding(CHECKED_VIEW, Severity.WARNING, finding, " ".join(map(str, further)) or RIG.move)
        ), None
    if as_configured:
        finding += f"; the {_QUICK} sequence is not sufficient"
        return CheckRow(_VIEW, Finding(CHECKED_VIEW, Severity.WARNING, finding, _UNREADABLE)), None
    return CheckRow(_VIEW, Finding(CHECKED_VIEW, Severity.NOTE, finding)), None


def nothing_lit() -> CheckRow:
    """Whether a white picture looks like a black one."""
    return CheckRow(
        _COVERAGE,
        Finding(
            CHECKED_COVERAGE,
            Severity.REFUSAL,
            "the camera sees no difference between a white and a black picture",
            "Point it at the projector's light; check lens cap, aperture and exposure, and that the projector is on.",
        ),
    )


def refusal_of(row: CheckRow) -> RefusalError:
    """A failed row as the reason why a scan would be refused."""
    reason = f"{capitalised(row.finding.message).rstrip('.')}."
    return RefusalError(row.finding.kind, reason, row.finding.advice, row.finding.data)
