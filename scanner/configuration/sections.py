"""Sections of a configuration: devices, patterns and scene."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from calib.geometry import PixelGrid, Size
from calib.refinement import DECENTERINGS, RADIAL, SQUARENESS_DEG, SQUARENESSES_DEG, THIRD_RADIAL
from hw.settings import Settings
from scanner.errors import InputError
from scanner.io import LONGEST_M, SHORTEST_M, Flag, Metres, Number, Pair, Whole, refuse_more_pixels
from scanner.patterns import PRESETS, Code, Pattern, Preset, PresetName, ProjectorResponse
from scanner.quantities import parse_length

_LARGEST_SIDE_PX = 32768
_MOST_DEVICES = 8
_NAME = re.compile(r"\w+")

Exposure = Annotated[Number, Field(gt=0, le=1e8)]
Period = Annotated[Number, Field(ge=4, le=1024)]


class _DeviceSettings(Settings):
    width: Whole | None = Field(default=None, ge=16, le=_LARGEST_SIDE_PX, description="Image width in pixels.")
    height: Whole | None = Field(default=None, ge=16, le=_LARGEST_SIDE_PX, description="Image height in pixels.")

    @model_validator(mode="after")
    def _both_or_neither(self) -> "_DeviceSettings":
        if (self.width is None) != (self.height is None):
            raise ValueError("give both width and height, or neither")
        refuse_more_pixels(self.width or 0, self.height or 0)
        return self

    @property
    def size(self) -> Size | None:
        """Of the image, or None if it is not given."""
        return None if self.width is None or self.height is None else Size(self.width, self.height)


class PrincipalPointSettings(Settings):
    """Prior knowledge of a principal point: `known`, or `prior` with `sigma_px`."""

    known: Pair | None = Field(
        default=None, description="If it was measured; (0, 0) is the centre of the top left pixel."
    )
    prior: Literal["centre"] | None = Field(default=None, description="Expected at the image's centre.")
    sigma_px: Number | None = Field(
        default=None,
        gt=0,
        le=_LARGEST_SIDE_PX,
        description="Standard deviation of the prior; default: 3 % of the width.",
    )

    @property
    def given(self) -> bool:
        """Whether anything is said."""
        return self.known is not None or self.prior is not None or self.sigma_px is not None

    @model_validator(mode="after")
    def _known_or_prior(self) -> "PrincipalPointSettings":
        if self.known is not None and (self.prior is not None or self.sigma_px is not None):
            raise ValueError("give known: [x, y], or prior: centre with sigma_px, not both")
        return self


class CameraSettings(_DeviceSettings):
    """The camera's image, and prior knowledge of its optics."""

    principal_point: PrincipalPointSettings = Field(
        default=PrincipalPointSettings(), description="{known: [x, y]}, or {prior: centre, sigma_px: …}."
    )


class ProjectorSettings(_DeviceSettings):
    """The projector's image, prior knowledge of its optics, and how bright it makes its grey levels."""

    principal_point: PrincipalPointSettings = Field(
        default=PrincipalPointSettings(),
        description="{known: [x, y]}, or {prior: centre, sigma_px: …}, in square pixels; default: anywhere.",
    )

    response: tuple[Number, ...] | None = Field(
        default=None,
        min_length=2,
        max_length=256,
        description="Light at equally spaced grey levels, 0 for black to 1 for white, as `scan check --write` "
        "measures it. Fringes are then projected as true sines; default: the decoder corrects gamma.",
    )

    pixel_aspect: Number = Field(
        default=1.0,
        ge=0.2,
        le=5,
        description="Height of its pixels over their width, 0.5 for diamond arrays of mirrors (LightCrafter 4500). "
        "Patterns, calibrations and exports are then in square pixels, of which it has twice the width.",
    )
    odd_rows: Number = Field(
        default=0.0,
        ge=-0.5,
        le=0.5,
        description="How far odd rows of pixels, counted from 0, stand to the right of even ones, in widths of a "
        "pixel; 0.5 or −0.5 for diamond arrays. Pictures are drawn accordingly.",
    )

    @model_validator(mode="after")
    def _rising(self) -> "ProjectorSettings":
        if self.response is not None:
            ProjectorResponse(self.response)
        return self

    @property
    def grid(self) -> PixelGrid:
        """Of its pixels."""
        return PixelGrid(self.pixel_aspect, self.odd_rows)

    @property
    def known_response(self) -> ProjectorResponse | None:
        """The response that scan check measured, if the configuration has it."""
        return None if self.response is None else ProjectorResponse(self.response)


class SequenceSettings(Settings):
    """The projected patterns; each key overrides the preset's."""

    preset: PresetName = Field(
        default="standard",
        description="The sequence to start from; photo cameras default to `quick`.",
    )
    code: Code | None = Field(
        default=None,
        description="`gray`; `xor`, finer stripes that resist interreflection; or `both`, checked against each other "
        "or the fringes.",
    )
    cell: Whole | None = Field(default=None, ge=1, le=1024, description="Finest Gray code stripe, in projector pixels.")
    inverses: Flag | None = Field(default=None, description="Each bit is followed by its inverse.")
    periods: tuple[Period, ...] | None = Field(
        default=None, min_length=1, max_length=8, description="Fringe periods in projector pixels."
    )
    shifts: Whole | None = Field(
        default=None, ge=0, le=64, description="Shifts of each fringe, 3 or more; 0 for no fringes."
    )

    exposures_us: tuple[Exposure, ...] = Field(
        default=(), max_length=8, description="Two or more exposures of each pattern; default: the rig's one."
    )

    @model_validator(mode="after")
    def _decodable(self) -> "SequenceSettings":
        chosen = self._chosen
        if chosen.shifts in (1, 2):
            raise ValueError(f"shifts must be 3 or more, or 0 for no fringes, found {chosen.shifts}")
        if len(set(chosen.periods)) < len(chosen.periods):
            raise ValueError(f"periods must differ, found {', '.join(f'{period:g}' for period in chosen.periods)}")
        if len(set(self.exposures_us)) < len(self.exposures_us) or len(self.exposures_us) == 1:
            raise ValueError("exposures_us must be two or more that differ, or left out")
        if chosen.shifts and chosen.cell > max(chosen.periods):
            raise ValueError(
                f"cell ({chosen.cell}) must not exceed the longest period ({max(chosen.periods)}), "
                "or fringes are ambiguous"
            )
        return self

    @property
    def _chosen(self) -> Preset:
        keys = ("code", "cell", "inverses", "periods", "shifts")
        return replace(
            PRESETS[self.preset], **{key: value for key in keys if (value := getattr(self, key)) is not None}
        )

    def patterns(self, projector_size: tuple[int, int]) -> tuple[Pattern, ...]:
        """The sequence for a projector of (width, height)."""
        return self._chosen.patterns(projector_size)


class CornerSettings(Settings):
    """Prior knowledge of the corner."""

    squareness_deg: Number | None = Field(
        default=None,
        ge=0,
        le=10,
        description="Standard deviation of the faces' angles from 90°; 0 if exact; default: walls as they are built, "
        f"of {' or '.join(f'{sigma:g}' for sigma, _ in SQUARENESSES_DEG)}, whichever the matches tell.",
    )
    same: Flag = Field(
        default=True,
        description="Several captures show the same corner, share its angles and are merged. Captures that refute "
        "this get angles of their own, and a note.",
    )

    @property
    def expected_squareness_deg(self) -> float:
        """The standard deviation where a single one is needed."""
        return SQUARENESS_DEG if self.squareness_deg is None else self.squareness_deg


class LensSettings(Settings):
    """Prior knowledge of both lenses."""

    radial: Number | None = Field(
        default=None,
        ge=0,
        le=10,
        description="Standard deviation of k1 and k2 of both lenses; 0 for ideal or corrected ones; default: "
        f"{RADIAL[0]:g} and {RADIAL[1]:g}.",
    )
    decentering: Number | None = Field(
        default=None,
        ge=0,
        le=0.1,
        description="Standard deviation of p1 and p2 of both lenses; 0 for none; default: lenses as they are sold, of "
        f"{' or '.join(f'{sigma:g}' for sigma, _ in DECENTERINGS)}, whichever the matches tell.",
    )
    k3: Number | None = Field(
        default=None, ge=0, le=10, description=f"Standard deviation of k3 of both lenses; default {THIRD_RADIAL:g}."
    )
    source: Path | None = Field(
        default=None,
        alias="from",
        description="A calibration.yaml, or a result that has one, whose lens terms and sigmas serve as the prior "
        "for devices of the same image size; path relative to this file.",
    )

    @model_validator(mode="after")
    def _one_source(self) -> "LensSettings":
        if self.source is not None and not {self.radial, self.decentering, self.k3} <= {None}:
            raise ValueError("give radial, decentering and k3, or from: calibration.yaml, not both")
        return self


class CharucoSettings(Settings):
    """A printed ChArUco board that lies flat in the scanned room, lit by the projector."""

    board: str = Field(default="6x9", pattern=r"^\d{1,2}x\d{1,2}$", description="Squares across and down.")
    square_mm: Number = Field(gt=0, le=1e4, description="Side of a square, measured on the print.")
    sigma_mm: Number | None = Field(default=None, gt=0, le=1e3, description="Its standard deviation; default: exact.")

    @model_validator(mode="after")
    def _possible(self) -> "CharucoSettings":
        if min(self.columns, self.rows) < 3:
            raise ValueError(f"board must be 3x3 squares or more, found {self.board}")
        if self.sigma_mm is not None and self.sigma_mm > 0.2 * self.square_mm:
            raise ValueError(f"sigma_mm ({self.sigma_mm:g}) must be well below square_mm, which is {self.square_mm:g}")
        return self

    @property
    def columns(self) -> int:
        """Squares across."""
        return int(self.board.partition("x")[0])

    @property
    def rows(self) -> int:
        """Squares down."""
        return int(self.board.partition("x")[2])


class _Usual(NamedTuple):
    """Lengths in metres that need no unit; others are written with theirs."""

    shortest_m: float
    longest_m: float

    def read(self, value: Any) -> Any:
        """A length with any unit, or a number, in metres. Raises ValueError for a number that is not usual."""
        if isinstance(value, str):
            try:
                return parse_length(value, "m")
            except InputError as error:
                raise ValueError(str(error)) from error
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if is_number and SHORTEST_M <= value <= LONGEST_M and not self.shortest_m <= value <= self.longest_m:
            raise ValueError(
                f"{value:g} without a unit are metres, where {self.shortest_m:g} to {self.longest_m:g} m are usual: "
                f"write {value:g}mm for millimetres, or {value:g}m if it is so"
            )
        return value

    def write(self, value: float | None) -> float | str | None:
        """What `read` takes."""
        return value if value is None or self.shortest_m <= value <= self.longest_m else f"{value!r}m"


_OF_BASELINE, _TO_CORNER = _Usual(0.005, 20.0), _Usual(0.05, 100.0)
Baseline = Annotated[Metres | None, BeforeValidator(_OF_BASELINE.read), PlainSerializer(_OF_BASELINE.write)]
ToCorner = Annotated[Metres | None, BeforeValidator(_TO_CORNER.read), PlainSerializer(_TO_CORNER.write)]


class ScaleSettings(Settings):
    """One known length; without it, the baseline is the unit."""

    baseline_m: Baseline = Field(default=None, description="Distance from camera to projector, as in 0.52 or 520mm.")
    camera_to_corner_m: ToCorner = Field(
        default=None, description="Distance from the camera to the corner's vertex, as in 2.5 or 250cm."
    )
    sigma_m: Number | None = Field(
        default=None, ge=1e-9, le=1e4, description="Standard deviation of that length; default: exact."
    )
    charuco: CharucoSettings | None = Field(
        default=None, description="{square_mm: …, board: 6x9}: a printed sheet in the scene, in place of a length."
    )

    @model_validator(mode="after")
    def _at_most_one(self) -> "ScaleSettings":
        given = [key for key in ("baseline_m", "camera_to_corner_m", "charuco") if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"give {' or '.join(given)}, not both: one length fixes the scale")
        length = self.baseline_m or self.camera_to_corner_m
        if self.sigma_m is not None and length is None:
            raise ValueError("sigma_m belongs to a length: give baseline_m or camera_to_corner_m with it")
        if self.sigma_m is not None and length is not None and self.sigma_m > 0.2 * length:
            raise ValueError(f"sigma_m ({self.sigma_m:g}) must be well below the length, which is {length:g}")
        return self


class NetworkSettings(Settings):
    """A network's cameras and projectors by name, each with the keys in which it differs."""

    cameras: dict[str, dict[str, Any]] = Field(
        min_length=1, max_length=_MOST_DEVICES, description="As in {left: {}, right: {rig: {camera: 1234}}}."
    )
    projectors: dict[str, dict[str, Any]] = Field(
        min_length=1,
        max_length=_MOST_DEVICES,
        description="As in {stage: {rig: {screen: 1}}, side: {rig: {screen: 2}}}.",
    )

    @property
    def pairs(self) -> Iterator[tuple[str, str]]:
        """Each camera with each projector, projector by projector."""
        return ((camera, projector) for projector in self.projectors for camera in self.cameras)

    @model_validator(mode="after")
    def _named(self) -> "NetworkSettings":
        names = [*self.cameras, *self.projectors]
        for name in names:
            if not _NAME.fullmatch(name):
                raise ValueError(f"{name!r} is no name of a device: expected letters, digits and underscores")
        if len(set(names)) < len(names):
            raise ValueError("a camera and a projector have the same name")
        return self
