"""What can be configured about a rig. The field descriptions become the configuration reference."""

from typing import ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

_PLACES_BEFORE_A_CORNER = 8


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class BumpSettings(_Part):
    """A simulated device is bumped once, and then points elsewhere."""

    device: Literal["camera", "projector"] = Field(default="projector", description="The device that moves.")
    frame: int = Field(
        default=0, ge=0, description="The first frame after the change; frames count from 0 when the rig is opened."
    )
    px: float = Field(
        default=0.0, ge=0.0, le=100.0, description="Displacement of the device's picture, in its own pixels."
    )
    direction_deg: float = Field(default=0.0, description="Direction: 0 to the picture's right, 90 down.")


class DriftSettings(_Part):
    """A simulated device rotates slowly, like a projector that warms up or a tripod that sinks."""

    device: Literal["camera", "projector"] = Field(default="projector", description="The device that moves.")
    px_per_frame: float = Field(
        default=0.0,
        ge=0.0,
        le=10.0,
        description="Displacement of the device's picture per frame, in its own pixels.",
    )
    direction_deg: float = Field(default=0.0, description="Direction: 0 to the picture's right, 90 down.")


class LightSettings(_Part):
    """The ambient light of the simulated room is switched."""

    frame: int = Field(
        default=0, ge=0, description="The first frame after the change; frames count from 0 when the rig is opened."
    )
    ambient: float | None = Field(
        default=None,
        ge=0.0,
        le=10.0,
        description="The value of rig.ambient from then on; left out, it does not change.",
    )


class PasserSettings(_Part):
    """A person walks between the devices and the corner of the simulated room."""

    width_m: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Width of the person, an upright box of 1.8 m; 0 for nobody."
    )
    first_frame: int = Field(default=0, ge=0, description="The frame in which the person enters on the camera's left.")
    last_frame: int = Field(default=0, ge=0, description="The frame in which the person leaves on the right.")


class PushedSettings(_Part):
    """A box in front of the corner of the simulated room is pushed to the camera's right during the capture."""

    width_m: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Width and depth of the box, 1.2 m high; 0 for no box."
    )
    frame: int = Field(default=0, ge=0, description="The first frame after the box was pushed.")
    by_m: float = Field(default=0.0, ge=0.0, le=2.0, description="Displacement of the box.")


class BoardSettings(_Part):
    """A printed board, held in front of the simulated rig or lying in its room."""

    kind: Literal["chessboard", "charuco"] = Field(default="chessboard", description="Kind of board.")
    columns: int = Field(
        default=9, ge=3, le=50, description="Inner corners in a row; of a ChArUco board, squares in a row."
    )
    rows: int = Field(default=7, ge=3, le=50, description="Rows of them.")
    on_floor: bool = Field(
        default=False,
        description="Whether the board lies on the floor, in a place drawn from the seed, instead of being held.",
    )
    square_m: float = Field(default=0.0, ge=0.0, le=1.0, description="Side of a square in metres; 0 for no board.")
    pose: int = Field(default=0, ge=0, description="Number of the pose, which is drawn from it and the seed.")
    bend: float = Field(
        default=0.002,
        ge=0.0,
        le=0.05,
        description="Standard deviation of each term of the board's bend, as a share of half its length.",
    )


class ThingSettings(_Part):
    """A thing on a turntable, or placed by hand, in front of the simulated rig instead of a room."""

    kind: Literal["none", "lump", "ball", "vase", "plate", "box", "file"] = Field(
        default="none",
        description="Shape: lump is drawn from the seed (a superquadric with waves), file is read; none is a room "
        "instead.",
    )
    file: str | None = Field(default=None, description="A mesh, for kind: file (PLY, OBJ, STL, OFF).")
    size_m: float = Field(default=0.1, gt=0.0, le=1.0, description="Longest side in metres.")
    steps: int = Field(default=24, ge=2, le=360, description="Number of poses; rig.pose is one of them.")
    step_deg: float | None = Field(
        default=None,
        gt=0.0,
        le=180.0,
        description="Rotation of the turntable per step; left out, a full turn in all steps.",
    )
    turntable: bool = Field(
        default=True, description="Whether the thing rotates on a turntable instead of being placed by hand each time."
    )
    background: bool = Field(default=True, description="Whether the turntable's plate, a table and a wall are visible.")
    patches: float = Field(
        default=0.6, ge=0.0, le=1.0, description="Contrast of the patches of its surface in albedo; 0 is plain."
    )
    gloss: float = Field(default=0.0, ge=0.0, le=5.0, description="Strength of specular highlights.")


class PanelSettings(_Part):
    """Scaling, keystone correction and mirroring of the picture by a simulated projector."""

    scale: float = Field(
        default=1.0, ge=0.3, le=3.0, description="Scale about the centre; above 1, the edges are cropped."
    )
    squeeze: float = Field(default=1.0, ge=0.5, le=1.0, description="Factor on the width: 0.75 shows 16:9 as 4:3.")
    keystone: float = Field(
        default=0.0,
        ge=0.0,
        le=0.5,
        description="Keystone: share by which the top edge is narrower than the bottom edge.",
    )
    mirrored: bool = Field(default=False, description="Whether the picture is mirrored, as for rear projection.")


class SimulatedRigSettings(BaseModel):
    """A simulated room with a simulated projector and camera in it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    backend: Literal["simulated"] = "simulated"
    seed: int = Field(0, ge=0, description="Seed of the room, its furniture, the rig and its poses.")
    room: Literal["corner", "whole"] = Field(
        "corner",
        description="One corner, or a whole room, furnished along all its walls, with a short-throw projector.",
    )
    stations: int = Field(
        6,
        ge=2,
        le=48,
        description="Number of stations around a whole room; each overlaps the next, and from 6 on the last overlaps "
        "the first.",
    )
    pose: int = Field(
        0,
        ge=0,
        description="Number of the rig's pose, of 8 in front of a corner, of rig.stations in a whole room; room and "
        "rig stay the same.",
    )
    projector_pose: int | None = Field(
        None,
        ge=0,
        description="Number of the projector's pose, as a device of a network with its own lens; left out, it stays "
        "with the camera.",
    )
    walls_off_deg: float = Field(
        0.0, ge=0.0, le=10.0, description="Standard deviation of each of the corner's three angles from 90 degrees."
    )
    furniture: bool = Field(
        True, description="Boxes, a cupboard and a sphere, which occlude and shadow parts of the room."
    )
    furniture_askew_deg: float = Field(
        0.0, ge=0.0, le=30.0, description="Standard deviation of the cupboard's angle to its wall."
    )
    hide_vertex: bool = Field(False, description="A box stands in the corner and hides its vertex from the camera.")
    sphere_radius_m: float = Field(0.12, ge=0.05, le=0.2, description="Radius of the sphere in metres.")
    ball_bar_m: float | None = Field(
        None,
        ge=0.15,
        le=5.0,
        description="Distance between the centres of two spheres, as on a ball bar; left out, there is one sphere.",
    )
    albedo: float | None = Field(
        None,
        ge=0.05,
        le=0.95,
        description="Mean albedo of walls and floor; left out, each has its own (0.35 to 0.8).",
    )
    refresh_hz: float = Field(60.0, ge=10.0, le=1000.0, description="Refresh rate of the projector.")
    pulsation: float = Field(
        0.0,
        ge=0.0,
        le=1.0,
        description="Amplitude of the projector's pulsation within a refresh period, relative to its mean: exposures "
        "that are no whole number of periods flicker.",
    )
    wallpaper: bool = Field(
        False, description="Walls and floor of the corner are patterned, with features everywhere for photos."
    )
    ambient: float = Field(
        0.05,
        ge=0.0,
        le=10.0,
        description="Ambient light relative to the projector's white.",
    )
    interreflection: bool = Field(True, description="Whether surfaces illuminate each other.")
    distortion: float = Field(
        1.0, ge=0.0, le=2.0, description="Factor on the random lens distortion of both devices; 0 for ideal lenses."
    )
    gamma: float = Field(2.2, ge=1.0, le=3.0, description="Exponent of the projector's response.")
    contrast: float = Field(1000.0, ge=10.0, description="The projector's white over its black.")
    ghost: float = Field(
        0.0,
        ge=0.0,
        le=0.9,
        description="Ghosting: share of a frame's light that is the previous picture's, as of a slow panel.",
    )
    flicker: float = Field(
        0.0,
        ge=0.0,
        le=0.9,
        description="Largest deviation of the projector's brightness in a frame at any exposure, as of a lamp or "
        "colour wheel that beats with it.",
    )
    rolling_shutter_ms: float = Field(
        0.0,
        ge=0.0,
        le=1000.0,
        description="Rolling shutter: delay of the camera's last row after its first. Light that flickers or pulsates "
        "at refresh_hz then shows as bands.",
    )
    stripe_loss: float = Field(
        0.0,
        ge=0.0,
        le=0.5,
        description="Share of its light that a stripe of one pixel loses to crosstalk of the panel; a stripe of two "
        "pixels loses half as much.",
    )
    sharpening: float = Field(
        0.0,
        ge=0.0,
        le=3.0,
        description="Sharpening by the projector: share that it adds of the difference to the picture blurred by one "
        "pixel.",
    )
    panel: PanelSettings = Field(
        default=PanelSettings(),
        description="{scale: …, keystone: …, …}: the projector scales, corrects or mirrors the picture.",
    )
    light: LightSettings = Field(
        default=LightSettings(), description="{frame: …, ambient: …}: the ambient light is switched."
    )
    passer: PasserSettings = Field(
        default=PasserSettings(),
        description="{width_m: …, first_frame: …, last_frame: …}: a person walks through the view.",
    )
    pushed: PushedSettings = Field(
        default=PushedSettings(), description="{width_m: …, frame: …, by_m: …}: a box is pushed aside."
    )
    board: BoardSettings = Field(
        default=BoardSettings(),
        description="{square_m: …, pose: …}: a board is held in front of the rig, or on the floor (on_floor: true).",
    )
    thing: ThingSettings = Field(
        default=ThingSettings(),
        description="{kind: …, size_m: …, steps: …}: the rig sees a thing instead of a room.",
    )
    bump: BumpSettings = Field(
        default=BumpSettings(), description="{device: …, frame: …, px: …}: a device is bumped once."
    )
    drift: DriftSettings = Field(default=DriftSettings(), description="{device: …, px_per_frame: …}: a device drifts.")
    projector_blur_px: float = Field(
        0.5, ge=0.0, le=4.0, description="Standard deviation of the projector lens's blur in projector pixels."
    )
    camera_blur_px: float = Field(
        0.5, ge=0.0, le=3.0, description="Standard deviation of the camera lens's blur in camera pixels."
    )
    camera_response: Literal["linear", "srgb", "photo"] = Field(
        "linear",
        description="Response: linear as of machine vision cameras, sRGB as of webcams, or with more contrast as of a "
        "photo camera's JPEG.",
    )
    exposure_us: float | None = Field(
        None,
        gt=0.0,
        description="Exposure in microseconds; left out, white reaches 85 % of the camera's range.",
    )
    bit_depth: Literal[8, 10, 12, 16] = Field(
        8, description="Bits of a camera pixel; more than 8 come as 16-bit images."
    )
    full_well_electrons: float = Field(
        10_500.0, ge=100.0, description="Electrons in a saturated camera pixel: sets the shot noise."
    )
    read_noise_electrons: float = Field(2.5, ge=0.0, description="Standard deviation of the read noise in electrons.")

    @property
    def places(self) -> int:
        """Number of poses of the rig."""
        if self.thing.kind != "none":
            return self.thing.steps
        return self.stations if self.room == "whole" else _PLACES_BEFORE_A_CORNER

    @model_validator(mode="after")
    def _pose_is_a_place(self) -> "SimulatedRigSettings":
        if self.pose >= self.places:
            raise ValueError(f"pose: expected 0 to {self.places - 1}, found {self.pose}")
        return self

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes per pixel of a frame."""
        return 1 if self.bit_depth == 8 else 2


USUAL_EXPOSURE_US = 2e6 / 60  # two refresh periods of most projectors


class CameraRigSettings(BaseModel):
    """Settings of every rig of real devices: a projector that is a screen, and a camera of a backend."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    slow: ClassVar[bool] = False  # a frame takes a second or longer

    backend: str
    exposure_us: float | None = None
    gain: float | None = None
    screen: int | str | None = Field(
        None,
        description="Number, name or geometry (as in 1920x1080+1920+0) of the projector's screen; left out, the only "
        "one of the projector's size.",
    )
    refresh_hz: float | None = Field(
        None, ge=10.0, le=1000.0, description="Refresh rate of the projector; left out, that of the screen's mode."
    )

    @property
    def has_gain(self) -> bool:
        """Whether the gain can be set."""
        return True

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes per pixel of a frame."""
        return 3
