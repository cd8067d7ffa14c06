"""The configuration: YAML and `--set KEY=VALUE` → typed, validated, immutable settings."""

import re
from collections.abc import Iterable, Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from calib.geometry import Size
from calib.refinement import DECENTERING, SQUARENESS_DEG, THIRD_RADIAL
from calib.self_calibration import PrincipalPoint
from hw.backends import RigSettings
from hw.settings import CameraRigSettings
from scanner.errors import InputError
from scanner.io import Flag, Number, Pair, Section, Whole, parse_yaml, read_yaml, refuse_more_pixels, validate
from scanner.patterns import PRESETS, Code, Pattern, Preset, PresetName, ProjectorResponse

# Of an unknown camera only the image's centre is known; real principal points scatter around it by a few per cent.
_CENTRE_SIGMA_OF_WIDTH = 0.03

_LARGEST_SIDE_PX = 32768
_MOST_EARLIER = 64
_MOST_DEVICES = 8
_NAME = re.compile(r"\w+")
# Of a recording's `capture.yaml`.
CONFIGURATION_KEY = "configuration"

Exposure = Annotated[Number, Field(gt=0, le=1e8)]
Period = Annotated[Number, Field(ge=4, le=1024)]


class _DeviceSettings(Section):
    width: Whole | None = Field(default=None, ge=16, le=_LARGEST_SIDE_PX, description="Width of the image in pixels.")
    height: Whole | None = Field(default=None, ge=16, le=_LARGEST_SIDE_PX, description="Height of the image in pixels.")

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


class PrincipalPointSettings(Section):
    """Prior knowledge of the camera's principal point: its position, or only that it is near the image's centre."""

    known: Pair | None = Field(
        default=None, description="(x, y) in pixels, if it was measured; the centre of the top left pixel is (0, 0)."
    )
    prior: Literal["centre"] | None = Field(default=None, description="Where it is expected, if it was not measured.")
    sigma_px: Number | None = Field(
        default=None, gt=0, le=_LARGEST_SIDE_PX, description="How far from there it may be; default 3 % of the width."
    )

    @model_validator(mode="after")
    def _known_or_prior(self) -> "PrincipalPointSettings":
        if self.known is not None and (self.prior is not None or self.sigma_px is not None):
            raise ValueError("give known: [x, y], or prior: centre with sigma_px, not both")
        return self


class CameraSettings(_DeviceSettings):
    """The camera's image, and what is known of its optics."""

    principal_point: PrincipalPointSettings = Field(
        default=PrincipalPointSettings(), description="{known: [x, y]}, or {prior: centre, sigma_px: …}."
    )


class ProjectorSettings(_DeviceSettings):
    """The projector's image, and how bright it makes its grey levels."""

    response: tuple[Number, ...] | None = Field(
        default=None,
        min_length=2,
        max_length=256,
        description="Light at equally spaced grey levels, from 0 for black to 1 for white, as scan check measures it; "
        "pictures are then sent so that fringes are true sines. Left out, the decoder straightens what gamma bends.",
    )

    @model_validator(mode="after")
    def _rising(self) -> "ProjectorSettings":
        if self.response is not None:
            ProjectorResponse(self.response)
        return self

    @property
    def known_response(self) -> ProjectorResponse | None:
        """The response that scan check measured, if the configuration has it."""
        return None if self.response is None else ProjectorResponse(self.response)


class SequenceSettings(Section):
    """Which patterns are projected; a key that is given overrides the preset."""

    preset: PresetName = Field(
        default="standard",
        description="The sequence to start from; left out with a camera that takes a second a frame, quick.",
    )
    code: Code | None = Field(
        default=None,
        description="gray; or xor: the same cells in fine stripes, which bounced light does not turn over; or both, "
        "which must agree with each other or one of them with the fringes.",
    )
    cell: Whole | None = Field(default=None, ge=1, le=1024, description="Finest Gray code stripe in projector pixels.")
    inverses: Flag | None = Field(default=None, description="Whether each bit is followed by its inverse.")
    periods: tuple[Period, ...] | None = Field(
        default=None, min_length=1, max_length=8, description="Periods of the fringes in projector pixels."
    )
    shifts: Whole | None = Field(
        default=None, ge=0, le=64, description="Steps of each fringe, 3 or more; 0 for no fringes."
    )

    exposures_us: tuple[Exposure, ...] = Field(
        default=(), max_length=8, description="Exposures of each pattern; left out, the one that the rig is set to."
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
                "or fringes look alike"
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


class CornerSettings(Section):
    """Prior knowledge of the corner."""

    squareness_deg: Number = Field(
        default=SQUARENESS_DEG,
        ge=0,
        le=10,
        description="Standard deviation of the faces' angles around 90°; 0 if exact.",
    )
    same: Flag = Field(default=True, description="Whether several captures show the same corner.")


class LensSettings(Section):
    """Prior knowledge of both lenses; values that are not given default to those of ordinary lenses."""

    decentering: Number | None = Field(
        default=None,
        ge=0,
        le=0.1,
        description="Standard deviation of p1 and p2 of both devices; 0 for lenses that are not decentred at all; "
        f"default {DECENTERING:g}.",
    )
    k3: Number | None = Field(
        default=None, ge=0, le=10, description=f"Standard deviation of k3 of both devices; default {THIRD_RADIAL:g}."
    )
    source: Path | None = Field(
        default=None,
        alias="from",
        description="A calibration.yaml, or a result that has one, by boards say, whose lens terms with their sigmas "
        "are expected of devices with the same image size; paths relative to this file.",
    )

    @model_validator(mode="after")
    def _one_source(self) -> "LensSettings":
        if self.source is not None and (self.decentering is not None or self.k3 is not None):
            raise ValueError("give decentering and k3, or from: calibration.yaml, not both")
        return self


class CharucoSettings(Section):
    """A printed ChArUco board that lies flat somewhere in the scanned room, lit by the projector."""

    board: str = Field(
        default="6x9", pattern=r"^\d{1,2}x\d{1,2}$", description="Squares across and down, as scan board counts them."
    )
    square_mm: Number = Field(gt=0, le=1e4, description="Side of a square, as it was measured on the print.")
    sigma_mm: Number | None = Field(
        default=None, gt=0, le=1e3, description="Standard deviation of that side; left out, it counts as exact."
    )

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


class ScaleSettings(Section):
    """One known length; without it, lengths are in units of the baseline."""

    baseline_m: Number | None = Field(default=None, gt=0, le=1e4, description="Distance from camera to projector.")
    camera_to_corner_m: Number | None = Field(
        default=None, gt=0, le=1e4, description="Distance from the camera to the point where the three faces meet."
    )
    sigma_m: Number | None = Field(
        default=None, gt=0, le=1e4, description="Standard deviation of that length; left out, it counts as exact."
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


# Of a camera that takes a second or more for a frame.
_PRESET_OF_SLOW: PresetName = "quick"


class NetworkSettings(Section):
    """Named cameras and projectors of a network: for each what differs from the other keys of this file."""

    cameras: dict[str, dict[str, Any]] = Field(
        min_length=1, max_length=_MOST_DEVICES, description="As in {left: {}, right: {rig: {serial: 1234}}}."
    )
    projectors: dict[str, dict[str, Any]] = Field(
        min_length=1,
        max_length=_MOST_DEVICES,
        description="As in {stage: {rig: {screen: 1}}, side: {rig: {screen: 2}}}.",
    )

    @model_validator(mode="after")
    def _named(self) -> "NetworkSettings":
        names = [*self.cameras, *self.projectors]
        for name in names:
            if not _NAME.fullmatch(name):
                raise ValueError(f"{name!r} is no name of a device: expected letters, digits and underscores")
        if len(set(names)) < len(names):
            raise ValueError("a camera and a projector have the same name")
        return self


class Config(Section):
    """Everything that can be configured. What a command needs and does not find is an InputError when it asks."""

    rig: RigSettings | None = Field(default=None, description="The devices.")
    camera: CameraSettings = Field(default=CameraSettings(), description="The camera's image and optics.")
    projector: ProjectorSettings = Field(default=ProjectorSettings(), description="The projector's image and response.")
    sequence: SequenceSettings = Field(default=SequenceSettings(), description="The patterns to project.")
    method: Literal["refined", "paper"] = Field(
        default="refined", description="Maximum likelihood with lens distortion, or the paper's objective alone."
    )
    corner: CornerSettings = Field(default=CornerSettings(), description="What is known of the corner.")
    lens: LensSettings = Field(default=LensSettings(), description="What is known of both lenses.")
    scale: ScaleSettings | None = Field(default=None, description="A known length.")
    rigs: NetworkSettings | None = Field(
        default=None, description="The devices of a network, of which rig is one pair."
    )
    earlier: tuple[Path, ...] = Field(
        default=(),
        max_length=_MOST_EARLIER,
        description="Earlier results, or matches, of this unchanged rig to calibrate together with the new capture; "
        "paths relative to this file.",
    )

    @model_validator(mode="after")
    def _few_frames_of_slow_cameras(self) -> "Config":
        """A sequence that nobody chose is worth its frames."""
        if (
            not isinstance(self.rig, CameraRigSettings)
            or not self.rig.slow
            or "preset" in self.sequence.model_fields_set
        ):
            return self
        sequence = SequenceSettings.model_validate(
            {"preset": _PRESET_OF_SLOW, **self.sequence.model_dump(exclude_unset=True)}
        )
        return self.model_copy(update={"sequence": sequence})

    @property
    def recorded(self) -> dict[str, Any]:
        """Return the settings in the form written into a recording, which `recorded_config` reads back."""
        data = self.model_dump(mode="json", exclude_unset=True, by_alias=True)
        if self.lens.source is not None:
            data["lens"] = {"from": str(self.lens.source.absolute())}
        return data | ({"earlier": [str(path.absolute()) for path in self.earlier]} if self.earlier else {})

    @property
    def required_rig(self) -> RigSettings:
        """The rig. Raises InputError if it is not configured."""
        if self.rig is None:
            raise InputError("the configuration has no 'rig': name the devices, as in rig: {backend: simulated}")
        return self.rig

    @property
    def pairs(self) -> dict[tuple[str, str], "Config"]:
        """The configuration of each pair of a network's devices, by camera and projector: projector by projector.

        Raises InputError if no network is configured, or what differs for a device is impossible.
        """
        if self.rigs is None:
            raise InputError(
                "the configuration has no 'rigs': name a network's devices, as in rigs: {cameras: {left: {}, right: "
                "{rig: {serial: 1234}}}, projectors: {stage: {}}}"
            )
        common = self.model_dump(mode="json", exclude_unset=True, by_alias=True, exclude={"rigs"})
        return {
            (camera, projector): validate(
                Config, _merged(_merged(common, of_camera), of_projector), f"rigs: {camera} with {projector}"
            )
            for projector, of_projector in self.rigs.projectors.items()
            for camera, of_camera in self.rigs.cameras.items()
        }

    @property
    def camera_size(self) -> Size:
        """The size of the camera's image. Raises InputError if it is not configured."""
        return _required_size("camera", self.camera.size)

    @property
    def projector_size(self) -> Size:
        """The size of the projector's image. Raises InputError if it is not configured."""
        return _required_size("projector", self.projector.size)

    def refuse_other_sizes(self, path: Path, camera: Size, projector: Size) -> None:
        """Raise InputError if what was read from `path` is of devices of other sizes than these."""
        for name, size, expected in (
            ("camera", camera, self.camera_size),
            ("projector", projector, self.projector_size),
        ):
            if size != expected:
                raise InputError(f"{path}: its {name} is {size}, but the configuration's is {expected}")

    def principal_point(self, camera_size: Size) -> PrincipalPoint:
        """Return the prior of the camera's principal point, for images of that size.

        Raises InputError if a known point belongs to images of another size, or lies far outside the image.
        """
        width, height = camera_size
        setting = self.camera.principal_point
        if setting.known is None:
            sigma_px = setting.sigma_px or _CENTRE_SIGMA_OF_WIDTH * width
            return PrincipalPoint(((width - 1) / 2, (height - 1) / 2), sigma_px)
        if self.camera.size not in (None, camera_size):
            raise InputError(
                f"the configuration's camera is {self.camera_size}, but the images are {camera_size}: "
                "camera.principal_point.known does not apply to them"
            )
        x, y = setting.known
        if not (-width <= x <= 2 * width and -height <= y <= 2 * height):
            raise InputError(f"camera.principal_point.known is ({x:g}, {y:g}), far outside of the {camera_size} image")
        return PrincipalPoint((x, y), 0.0)


def _required_size(device: str, size: Size | None) -> Size:
    if size is None:
        raise InputError(f"the configuration has no '{device}.width' and '{device}.height': give the size of its image")
    return size


def load_config(path: Path | None, overrides: Iterable[str] = ()) -> Config:
    """Read a configuration (None: an empty one) and put `KEY=VALUE` overrides over it.

    KEY is a dotted path, VALUE is YAML. Paths of earlier results may be relative to the configuration's folder; they
    come back ready to be opened. Raises InputError for a missing or malformed file, an unknown key (naming the nearest
    known one), a value that is impossible, or an override that is no KEY=VALUE.
    """
    data = {} if path is None else read_yaml(path)
    for override in overrides:
        _apply(override, data)
    where = "configuration" if path is None else str(path)
    config = validate(Config, data, where)
    if path is None:
        return config
    found: dict[str, Any] = {}
    if config.earlier:
        found["earlier"] = tuple(path.parent / earlier for earlier in config.earlier)
    if config.lens.source is not None:
        found["lens"] = config.lens.model_copy(update={"source": path.parent / config.lens.source})
    return config.model_copy(update=found)


def recorded_config(metadata: Mapping[str, Any], where: str, overrides: Iterable[str] = ()) -> Config:
    """The configuration that a recording was made with, from its `capture.yaml`, with `KEY=VALUE` overrides over it.

    Raises InputError if it does not say so.
    """
    data = metadata.get(CONFIGURATION_KEY)
    if not isinstance(data, dict):
        raise InputError(f"{where}: does not say with which configuration it was made: give it with --config FILE")
    data = deepcopy(data)
    for override in overrides:
        _apply(override, data)
    return validate(Config, data, f"{where}, {CONFIGURATION_KEY}")


def _apply(override: str, data: dict[str, Any]) -> None:
    key, equals, text = override.partition("=")
    if not equals or not re.fullmatch(r"\w+(\.\w+)*", key):
        raise InputError(f"--set {override}: expected KEY=VALUE with a key such as camera.width")
    *sections, name = key.split(".")
    place = data
    for section in sections:
        inner = place.get(section)
        if inner is None:
            inner = place[section] = {}
        if not isinstance(inner, dict):
            raise InputError(f"--set {override}: '{section}' is a value, not a section, so it has no '{name}'")
        place = inner
    place[name] = parse_yaml(text, f"--set {override}")


def _merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Return one section with the keys of another in their places, at any depth."""
    both = {key: _merged(one[key], value) for key, value in other.items() if _are_sections(one.get(key), value)}
    return {**one, **other, **both}


def _are_sections(one: object, other: object) -> bool:
    return isinstance(one, Mapping) and isinstance(other, Mapping)
