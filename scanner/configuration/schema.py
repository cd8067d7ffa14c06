"""The configuration: YAML and `--set KEY=VALUE` → typed, validated, immutable settings."""

import json
import re
from collections.abc import Iterable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from calib.geometry import Size
from calib.refinement import PrincipalPoint
from hw.backends import RigSettings
from hw.settings import CameraRigSettings, Settings, without_passwords
from scanner.configuration.cloud_steps import CloudSettings
from scanner.configuration.sections import (
    CameraSettings,
    CornerSettings,
    LensSettings,
    NetworkSettings,
    PrincipalPointSettings,
    ProjectorSettings,
    ScaleSettings,
    SequenceSettings,
)
from scanner.errors import InputError
from scanner.io import parse_yaml, read_yaml, refuse_other_sizes, validate
from scanner.patterns import PresetName

# Of an unknown camera only the image's centre is known; real principal points deviate by a few per cent.
_CENTRE_SIGMA_OF_WIDTH = 0.03

_MOST_EARLIER = 64
# For cameras that take a second or more per frame.
_WHOLE = "principal_point"  # a section whose keys exclude each other
_PRESET_OF_SLOW: PresetName = "quick"
# In a recording's `capture.yaml`.
CONFIGURATION_KEY = "configuration"


class Config(Settings):
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
    cloud: CloudSettings = Field(default=CloudSettings(), description="What is done to the cloud afterwards.")
    rigs: NetworkSettings | None = Field(
        default=None, description="The devices of a network, of which rig is one pair."
    )
    earlier: tuple[Path, ...] = Field(
        default=(),
        max_length=_MOST_EARLIER,
        description="Earlier results or matches of this unchanged rig, to calibrate together with the new capture; "
        "paths relative to this file.",
    )

    @model_validator(mode="after")
    def _few_frames_of_slow_cameras(self) -> "Config":
        """The default sequence of slow cameras is short."""
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

    def as_json(self, *, by_alias: bool = False) -> str:
        """What was set, for files, pages and logs: without passwords."""
        return without_passwords(self.model_dump_json(exclude_unset=True, by_alias=by_alias))

    @property
    def recorded(self) -> dict[str, Any]:
        """The settings as written into a recording, without passwords, which `recorded_config` reads back."""
        data: dict[str, Any] = json.loads(self.as_json(by_alias=True))
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
        """The configuration of each pair of a network's devices, by camera and projector, projector by projector.

        Raises InputError if no network is configured, or settings of a device are invalid.
        """
        if self.rigs is None:
            raise InputError(
                "the configuration has no 'rigs': name a network's devices, as in rigs: {cameras: {left: {}, right: "
                "{rig: {camera: 1234}}}, projectors: {stage: {}}}"
            )
        common = self.model_dump(mode="json", exclude_unset=True, by_alias=True, exclude={"rigs"})
        own = self.rigs
        return {
            (camera, projector): validate(
                Config,
                _merged(_merged(common, own.cameras[camera]), own.projectors[projector]),
                f"rigs: {camera} with {projector}",
            )
            for camera, projector in own.pairs
        }

    def of_device(self, name: str) -> "Config":
        """The configuration with the keys in which a network's device of that name differs; itself if none does.

        Raises InputError if settings of the device are invalid.
        """
        own = {} if self.rigs is None else self.rigs.cameras.get(name) or self.rigs.projectors.get(name)
        if not own:
            return self
        common = self.model_dump(mode="json", exclude_unset=True, by_alias=True, exclude={"rigs"})
        return validate(Config, _merged(common, own), f"rigs: {name}")

    @property
    def camera_size(self) -> Size:
        """The size of the camera's image. Raises InputError if it is not configured."""
        return _required_size("camera", self.camera.size)

    @property
    def projector_size(self) -> Size:
        """The size of the projector's image, in square pixels. Raises InputError if it is not configured."""
        return self.projector.grid.square_size(_required_size("projector", self.projector.size))

    def refuse_other_sizes(self, path: Path, camera: Size, projector: Size) -> None:
        """Raise InputError if the content of `path` belongs to devices of other sizes."""
        expected = self.camera_size, self.projector_size
        refuse_other_sizes(path, (camera, projector), expected, "the configuration's")

    def principal_point(self, camera_size: Size) -> PrincipalPoint:
        """Return the prior of the camera's principal point, for images of that size.

        Raises InputError if a known point belongs to images of another size, or lies far outside the image.
        """
        return _principal_point("camera", self.camera.principal_point, self.camera.size, camera_size)

    def projector_point(self, projector_size: Size) -> PrincipalPoint | None:
        """Return the prior of the projector's principal point, for pictures of that size in square pixels; None if the
        configuration says nothing of it.

        Raises InputError as for the camera's.
        """
        setting = self.projector.principal_point
        if not setting.given:
            return None
        own = self.projector.size
        size = None if own is None else self.projector.grid.square_size(own)
        return _principal_point("projector", setting, size, projector_size)


def _principal_point(device: str, setting: PrincipalPointSettings, own_size: Size | None, size: Size) -> PrincipalPoint:
    """For images of a `size`; the configuration's are of `own_size`, if it has one."""
    width, height = size
    if setting.known is None:
        sigma_px = setting.sigma_px or _CENTRE_SIGMA_OF_WIDTH * width
        return PrincipalPoint(((width - 1) / 2, (height - 1) / 2), sigma_px)
    if own_size not in (None, size):
        raise InputError(
            f"the configuration's {device} is {own_size}, but the images are {size}: "
            f"{device}.principal_point.known does not apply to them"
        )
    x, y = setting.known
    if not (-width <= x <= 2 * width and -height <= y <= 2 * height):
        raise InputError(f"{device}.principal_point.known is ({x:g}, {y:g}), far outside the {size} image")
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
    values: dict[str, Any] = {}
    if config.earlier:
        values["earlier"] = tuple(path.parent / earlier for earlier in config.earlier)
    if config.lens.source is not None:
        values["lens"] = config.lens.model_copy(update={"source": path.parent / config.lens.source})
    return config.model_copy(update=values)


def recorded_config(metadata: Mapping[str, Any], where: str, overrides: Iterable[str] = ()) -> Config:
    """The configuration that a recording was made with, from its `capture.yaml`, with `KEY=VALUE` overrides over it.

    Raises InputError if it does not say so.
    """
    data = metadata.get(CONFIGURATION_KEY)
    if not isinstance(data, dict):
        raise InputError(f"{where}: contains no configuration: give one with --config FILE")
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


def _merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return one section with the keys of another in their places, at any depth but that of a principal point."""
    both = {
        key: _merged(base[key], value)
        for key, value in changes.items()
        if key != _WHOLE and _are_sections(base.get(key), value)
    }
    return {**base, **changes, **both}


def _are_sections(base: object, changes: object) -> bool:
    return isinstance(base, Mapping) and isinstance(changes, Mapping)
