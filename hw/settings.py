"""What can be configured about a rig. The field descriptions become the configuration reference."""

from typing import ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

_PLACES_BEFORE_A_CORNER = 8


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class BumpSettings(_Part):
    """Someone knocks once against a simulated device, which then points elsewhere."""

    device: Literal["camera", "projector"] = Field(default="projector", description="Which device it is.")
    frame: int = Field(
        default=0, ge=0, description="The first frame after it; they are counted from 0 since the rig is open."
    )
    px: float = Field(
        default=0.0, ge=0.0, le=100.0, description="How far it moves the device's picture, in its own pixels."
    )
    direction_deg: float = Field(default=0.0, description="Where to: 0 to the picture's right, 90 down.")


class DriftSettings(_Part):
    """A simulated device turns slowly: a projector that warms up, a tripod that sinks."""

    device: Literal["camera", "projector"] = Field(default="projector", description="Which device it is.")
    px_per_frame: float = Field(
        default=0.0,
        ge=0.0,
        le=10.0,
        description="How far the device's picture moves from frame to frame, in its own pixels.",
    )
    direction_deg: float = Field(default=0.0, description="Where to: 0 to the picture's right, 90 down.")


class LightSettings(_Part):
    """Someone switches the light in the simulated room."""

    frame: int = Field(
        default=0, ge=0, description="The first frame after it; they are counted from 0 since the rig is open."
    )
    ambient: float | None = Field(
        default=None, ge=0.0, le=10.0, description="What rig.ambient is from then on; left out, nobody does."
    )


class PasserSettings(_Part):
    """Somebody, or something, goes past between the devices and the corner of the simulated room."""

    width_m: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Width of an upright box of 1.8 m; 0.4 is a person, 0 is nobody."
    )
    first_frame: int = Field(default=0, ge=0, description="The frame in which it comes in on the camera's left.")
    last_frame: int = Field(default=0, ge=0, description="The frame in which it leaves on the right.")


class PushedSettings(_Part):
    """A box stands before the corner of the simulated room, and is pushed to the camera's right during the capture."""

    width_m: float = Field(
        default=0.0, ge=0.0, le=1.0, description="How wide and deep it is, at a height of 1.2 m; 0 is none."
    )
    frame: int = Field(default=0, ge=0, description="The first frame in which it stands elsewhere.")
    by_m: float = Field(default=0.0, ge=0.0, le=2.0, description="How far it is pushed.")


class BoardSettings(_Part):
    """A printed board, held before the simulated rig or lying in its room."""

    kind: Literal["chessboard", "charuco"] = Field(default="chessboard", description="What is printed on it.")
    columns: int = Field(
        default=9, ge=3, le=50, description="Inner corners in a row; of a ChArUco board, squares in a row."
    )
    rows: int = Field(default=7, ge=3, le=50, description="Rows of them.")
    on_floor: bool = Field(
        default=False,
        description="Whether it lies flat on the floor, in a place that is drawn from the seed; else it is held.",
    )
    square_m: float = Field(default=0.0, ge=0.0, le=1.0, description="Side of a square in metres; 0 is no board.")
    pose: int = Field(default=0, ge=0, description="How it is held: drawn from the seed and this number.")
    bend: float = Field(
        default=0.002,
        ge=0.0,
        le=0.05,
        description="Standard deviation of each term of its bend, as a share of half its length.",
    )


class ThingSettings(_Part):
    """A thing on a turntable, or put down by hand, that the simulated rig looks at instead of a room."""

    kind: Literal["none", "lump", "ball", "vase", "plate", "box", "file"] = Field(
        default="none",
        description="Its shape: lump is drawn from the seed (a superquadric with waves over it), file is read; none is "
        "a room instead.",
    )
    file: str | None = Field(default=None, description="A mesh, for kind: file (PLY, OBJ, STL, OFF).")
    size_m: float = Field(default=0.1, gt=0.0, le=1.0, description="Its longest side in metres.")
    steps: int = Field(default=24, ge=2, le=360, description="How many poses it has; rig.pose is one of them.")
    step_deg: float | None = Field(
        default=None,
        gt=0.0,
        le=180.0,
        description="How far the turntable turns in a step; left out, once round in all.",
    )
    turntable: bool = Field(
        default=True, description="Whether it turns on a turntable; else it is put down another way each time."
    )
    background: bool = Field(
        default=True, description="The turntable's plate, a table and a wall; else there is nothing."
    )
    patches: float = Field(
        default=0.6, ge=0.0, le=1.0, description="How much patches of its surface differ in albedo; 0 is plain."
    )
    gloss: float = Field(default=0.0, ge=0.0, le=5.0, description="How much of a highlight its surface has.")


class PanelSettings(_Part):
    """What a simulated projector makes of the picture's shape before it shows it."""

    scale: float = Field(
        default=1.0, ge=0.3, le=3.0, description="Enlargement about the centre; above 1, the edges are cropped."
    )
    squeeze: float = Field(default=1.0, ge=0.5, le=1.0, description="Factor on the width: 0.75 shows 16:9 as 4:3.")
    keystone: float = Field(
        default=0.0, ge=0.0, le=0.5, description="How much narrower than the bottom edge the top edge is shown."
    )
    mirrored: bool = Field(default=False, description="Whether right and left are exchanged, as for a screen's back.")


class SimulatedRigSettings(BaseModel):
    """A simulated room with a simulated projector and camera in it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    backend: Literal["simulated"] = "simulated"
    seed: int = Field(0, ge=0, description="Draws the room, its furniture, the rig and the places it looks from.")
    room: Literal["corner", "whole"] = Field(
        "corner",
        description="What the rig is carried round: one corner, or the whole room, furnished along all its walls, with "
        "a projector that throws wide.",
    )
    stations: int = Field(
        6,
        ge=2,
        le=48,
        description="How many places there are round a whole room; each sees a part of the next one's, and from 6 on "
        "the last one a part of the first one's.",
    )
    pose: int = Field(
        0,
        ge=0,
        description="Which of its places the rig stands at, of 8 before a corner, of rig.stations in a whole room; "
        "room and rig stay the same.",
    )
    projector_pose: int | None = Field(
        None,
        ge=0,
        description="Which of these places the projector stands at, as one of a network, with a lens of its own; left "
        "out, it stays with the camera.",
    )
    walls_off_deg: float = Field(
        0.0, ge=0.0, le=10.0, description="Standard deviation of each of the corner's three angles from 90 degrees."
    )
    furniture: bool = Field(True, description="Boxes, a cupboard and a sphere, which hide and shade parts of the room.")
    furniture_askew_deg: float = Field(
        0.0, ge=0.0, le=30.0, description="Standard deviation of the cupboard's angle to the wall that it stands at."
    )
    hide_vertex: bool = Field(False, description="A box stands in the corner and hides its vertex from the camera.")
    sphere_radius_m: float = Field(0.12, ge=0.05, le=0.2, description="Radius of the sphere in metres.")
    ball_bar_m: float | None = Field(
        None,
        ge=0.15,
        le=5.0,
        description="Distance between the centres of the sphere and of a second one, as on a ball bar; left out, there "
        "is one sphere.",
    )
    albedo: float | None = Field(
        None,
        ge=0.05,
        le=0.95,
        description="Mean share of light that walls and floor reflect; left out, each has its own (0.35 to 0.8).",
    )
    refresh_hz: float = Field(
        60.0, ge=10.0, le=1000.0, description="How many pictures the projector builds up in a second."
    )
    pulsation: float = Field(
        0.0,
        ge=0.0,
        le=1.0,
        description="How much the light pulsates within a refresh period, relative to its mean: exposures that are no "
        "whole number of periods flicker.",
    )
    wallpaper: bool = Field(
        False, description="Walls and floor of the corner are patterned, with something to match everywhere for photos."
    )
    ambient: float = Field(
        0.05,
        ge=0.0,
        le=10.0,
        description="Light in the room beside the projector's, relative to the projector's white.",
    )
    interreflection: bool = Field(True, description="Whether surfaces light each other.")
    distortion: float = Field(
        1.0, ge=0.0, le=2.0, description="Factor on the drawn lens distortions of both devices; 0 for ideal lenses."
    )
    gamma: float = Field(2.2, ge=1.0, le=3.0, description="Exponent of the projector's response.")
    contrast: float = Field(1000.0, ge=10.0, description="The projector's white over its black.")
    ghost: float = Field(
        0.0,
        ge=0.0,
        le=0.9,
        description="Share of a frame's light that is still the previous picture's, as of a slow panel.",
    )
    flicker: float = Field(
        0.0,
        ge=0.0,
        le=0.9,
        description="How much brighter or darker than usual the projector is in a frame at most, whatever the "
        "exposure: a lamp or colour wheel that beats with it.",
    )
    rolling_shutter_ms: float = Field(
        0.0,
        ge=0.0,
        le=1000.0,
        description="How much later than the camera's first row the last is exposed: light that flickers or pulsates, "
        "at refresh_hz, then shows as bands.",
    )
    stripe_loss: float = Field(
        0.0,
        ge=0.0,
        le=0.5,
        description="Share of its light that a stripe of one pixel loses to crosstalk between the panel's pixels; one "
        "of two pixels loses half as much.",
    )
    sharpening: float = Field(
        0.0,
        ge=0.0,
        le=3.0,
        description="How much the projector sharpens: the share of the difference to the picture blurred by one pixel "
        "that it adds.",
    )
    panel: PanelSettings = Field(
        default=PanelSettings(), description="{scale: …, keystone: …, …}: the projector changes the picture's shape."
    )
    light: LightSettings = Field(
        default=LightSettings(), description="{frame: …, ambient: …}: the light in the room is switched."
    )
    passer: PasserSettings = Field(
        default=PasserSettings(), description="{width_m: …, first_frame: …, last_frame: …}: somebody goes past."
    )
    pushed: PushedSettings = Field(
        default=PushedSettings(), description="{width_m: …, frame: …, by_m: …}: a box is pushed aside."
    )
    board: BoardSettings = Field(
        default=BoardSettings(),
        description="{square_m: …, pose: …}: a board is held before the rig; with on_floor: true it lies on the floor.",
    )
    thing: ThingSettings = Field(
        default=ThingSettings(),
        description="{kind: …, size_m: …, steps: …}: the rig looks at a thing, not into a room.",
    )
    bump: BumpSettings = Field(
        default=BumpSettings(), description="{device: …, frame: …, px: …}: a device is knocked against once."
    )
    drift: DriftSettings = Field(
        default=DriftSettings(), description="{device: …, px_per_frame: …}: a device turns slowly."
    )
    projector_blur_px: float = Field(
        0.5, ge=0.0, le=4.0, description="Standard deviation of the projector lens's blur in projector pixels."
    )
    camera_blur_px: float = Field(
        0.5, ge=0.0, le=3.0, description="Standard deviation of the camera lens's blur in camera pixels."
    )
    camera_response: Literal["linear", "srgb", "photo"] = Field(
        "linear",
        description="From light to grey levels: as machine vision cameras have it, as web cameras, or as a photo "
        "camera's JPEG, with more contrast.",
    )
    exposure_us: float | None = Field(
        None,
        gt=0.0,
        description="Exposure time in microseconds; left out, a white picture reaches 85 % of the camera's range.",
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
        """How many there are."""
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
        """Of a frame."""
        return 1 if self.bit_depth == 8 else 2


USUAL_EXPOSURE_US = 2e6 / 60  # two refresh periods of most projectors


class CameraRigSettings(BaseModel):
    """What all rigs of real devices have: a projector that is a screen, and a camera that a backend reaches."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    slow: ClassVar[bool] = False  # it takes a second a frame, or longer

    backend: str
    exposure_us: float | None = None
    gain: float | None = None
    screen: int | str | None = Field(
        None,
        description="Number, name or geometry (as in 1920x1080+1920+0) of the projector's screen, or an X display of "
        "its own (as in :0.1); left out, the only screen of the projector's size.",
    )
    refresh_hz: float | None = Field(
        None, ge=10.0, le=1000.0, description="Refresh rate of the projector; left out, that of the screen's mode."
    )

    @property
    def has_gain(self) -> bool:
        """Whether it can be asked for."""
        return True

    @property
    def bytes_per_pixel(self) -> int:
        """Of a frame."""
        return 3
