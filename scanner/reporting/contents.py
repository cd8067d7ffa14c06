"""What a report is made from."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from calib.calibration import Calibration
from calib.matches import Matches
from calib.refusal import RefusalError
from calib.selfcalibration import SelfCalibration
from scanner.cloud import Cloud
from scanner.decode import Decoding
from scanner.patterns import Pattern


@dataclass(frozen=True)
class CaptureFacts:
    """How the capture was taken: sizes are (width, height); what is not known is left out.

    `identity` names devices and whatever else the recording says about itself. `exposure_us`: the frames' exposures.
    """

    camera_size: tuple[int, int]
    projector_size: tuple[int, int]
    patterns: tuple[Pattern, ...] = ()
    identity: Mapping[str, str] = field(default_factory=dict)
    exposure_us: tuple[float, ...] = ()


@dataclass(frozen=True)
class ReportInput:
    """Everything that a report may tell; only the capture and its matches are always there.

    `matches` carry face labels where faces were found. `calibration` is the one in use, with its scale: found by
    `solution`, or given by the operator if there is no solution. `refusal` says why there is none. `truth` belongs to a
    simulated rig. `files` are the names in the result folder. A result has a calibration or a refusal, never both.

    Raises ValueError if it has both, or neither.
    """

    capture: CaptureFacts
    matches: Matches
    title: str = "Scan"
    decoding: Decoding | None = None
    solution: SelfCalibration | None = None
    calibration: Calibration | None = None
    cloud: Cloud | None = None
    refusal: RefusalError | None = None
    truth: Calibration | None = None
    warnings: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if (self.calibration is None) == (self.refusal is None):
            raise ValueError("a report needs a calibration or a refusal, and not both")

    @property
    def decoded_share(self) -> float:
        """Matches per camera pixel."""
        width, height = self.capture.camera_size
        return len(self.matches) / (width * height)
