"""What can be configured about a rig. The field descriptions become the configuration reference."""

import re
from typing import ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from calib.geometry import PixelGrid

_PLACES_BEFORE_A_CORNER = 8
_PASSWORD = re.compile(r"""(?<=://)([^\s/@:"']*):[^\s/"']*@""")


def without_passwords(text: str) -> str:
    """A text without the passwords of the addresses in it, as of http://user:password@host."""
    return _PASSWORD.sub(r"\1@", text)


class Settings(BaseModel):
    """A part of a configuration: immutable, and a key that it does not know is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class BumpSettings(Settings):
    """Someone knocks once against a simulated device."""

    device: Literal["camera", "projector"] = Field(default="projector", description="The device.")
    frame: int = Field(
        default=0, ge=0, description="The first frame after it, counted from 0 since the rig was opened."
    )
    px: float = Field(default=0.0, ge=0.0, le=100.0, description="How far its picture moves, in its own pixels.")
    direction_deg: float = Field(default=0.0, description="Where to: 0 right, 90 down.")


class DriftSettings(Settings):
    """A simulated device turns slowly, as a warming projector does."""

    device: Literal["camera", "projector"] = Field(default="projector", description="The device.")
    px_per_frame: float = Field(
        default=0.0,
        ge=0.0,
        le=10.0,
        description="How far its picture moves per frame, in its own pixels.",
    )
    direction_deg: float = Field(default=0.0, description="Where to: 0 right, 90 down.")


class LightSettings(Settings):
    """The light in the simulated room is switched."""

    frame: int = Field(
        default=0, ge=0, description="The first frame after it, counted from 0 since the rig was opened."
    )
    ambient: float | None = Field(
        default=None, ge=0.0, le=10.0, description="`rig.ambient` from then on; default: no switch."
    )


class PasserSettings(Settings):
    """A person walks through the simulated picture."""

    width_m: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Width of an upright box of 1.8 m: 0.4 for a person, 0 for none."
    )
    first_frame: int = Field(default=0, ge=0, description="The frame in which it enters from the left.")
    last_frame: int = Field(default=0, ge=0, description="The frame in which it leaves on the right.")


class PushedSettings(Settings):
    """A box in front of the simulated corner is pushed to the right."""

    width_m: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Width and depth of the box, 1.2 m high; 0 for none."
    )
    frame: int = Field(default=0, ge=0, description="The first frame after the push.")
    by_m: float = Field(default=0.0, ge=0.0, le=2.0, description="How far it is pushed.")


class BoardSettings(Settings):
    """A printed board in front of the simulated rig or on its floor."""

    kind: Literal["chessboard", "charuco"] = Field(default="chessboard", description="What is printed on it.")
    columns: int = Field(default=9, ge=3, le=50, description="Inner corners in a row; squares for ChArUco.")
    rows: int = Field(default=7, ge=3, le=50, description="The same, in a column.")
    on_floor: bool = Field(
        default=False,
        description="Lies flat on the floor instead of being held.",
    )
    square_m: float = Field(default=0.0, ge=0.0, le=1.0, description="Side of a square; 0 for no board.")
    pose: int = Field(default=0, ge=0, description="Number of the random pose.")
    bend: float = Field(
        default=0.002,
        ge=0.0,
        le=0.05,
        description="Standard deviation of each bending term, relative to half its length.",
    )


class ThingSettings(Settings):
    """A thing that the simulated rig looks at instead of a room."""

    kind: Literal["none", "lump", "ball", "vase", "plate", "box", "file"] = Field(
        default="none",
        description="Shape; `lump` is random, `file` is read, `none` is a room instead.",
    )
    file: str | None = Field(default=None, description="A mesh for `kind: file` (PLY, OBJ, STL, OFF).")
    size_m: float = Field(default=0.1, gt=0.0, le=1.0, description="Longest side.")
    steps: int = Field(default=24, ge=2, le=360, description="Number of poses, numbered by `rig.pose`.")
    step_deg: float | None = Field(
        default=None,
        gt=0.0,
        le=180.0,
        description="Angle of a turntable step; default: one full turn in all.",
    )
    turntable: bool = Field(default=True, description="On a turntable; otherwise put down differently each time.")
    tip_deg: float = Field(
        default=0.0, ge=0.0, le=90.0, description="Angle by which it is tipped at every third step of the turntable."
    )
    background: bool = Field(default=True, description="Turntable, table and wall are visible.")
    patches: float = Field(default=0.6, ge=0.0, le=1.0, description="Contrast of the patches on its surface.")
    gloss: float = Field(default=0.0, ge=0.0, le=5.0, description="Strength of the highlight.")
    camera_place: int = Field(
        default=0, ge=0, description="The camera's place, each with its own lens, as in a network."
    )
    projector_place: int = Field(
        default=0, ge=0, description="The projector's place, each with its own lens, as in a network."
    )


class PanelSettings(Settings):
    """How the simulated projector distorts its picture."""

    scale: float = Field(
        default=1.0, ge=0.3, le=3.0, description="Enlargement about the centre; above 1, edges are cropped."
    )
    squeeze: float = Field(default=1.0, ge=0.5, le=1.0, description="Factor on the width: 0.75 shows 16:9 as 4:3.")
    keystone: float = Field(
        default=0.0, ge=0.0, le=0.5, description="Share by which the top edge is narrower than the bottom edge."
    )
    mirrored: bool = Field(default=False, description="Left and right exchanged, as in rear projection.")


class SimulatedRigSettings(Settings):
    """A simulated projector and camera in a simulated room."""

    backend: Literal["simulated"] = "simulated"
    seed: int = Field(0, ge=0, description="Draws room, furniture, rig and places.")
    room: Literal["corner", "whole"] = Field(
        "corner",
        description="One corner, or a whole furnished room and a wide-angle projector.",
    )
    stations: int = Field(
        6,
        ge=2,
        le=48,
        description="Number of places in a whole room; neighbours overlap, and from 6 on the circle closes.",
    )
    pose: int = Field(
        0,
        ge=0,
        description="Which place the rig stands at: one of 8 in front of a corner, of `rig.stations` in a whole room.",
    )
    projector_pose: int | None = Field(
        None,
        ge=0,
        description="The projector's place, if it stands elsewhere, with its own lens, as in a network.",
    )
    walls_off_deg: float = Field(
        0.0, ge=0.0, le=10.0, description="Standard deviation of the corner's angles from 90°."
    )
    pixel_aspect: float = Field(
        1.0, ge=0.2, le=5.0, description="Height of the projector's pixels over their width; 0.5 for a diamond array."
    )
    odd_rows: float = Field(
        0.0,
        ge=-0.5,
        le=0.5,
        description="How far odd rows of them stand to the right of even ones, in widths of a pixel; ± 0.5 for a "
        "diamond array.",
    )
    furniture: bool = Field(True, description="Boxes, a cupboard and a sphere, which hide and shade parts.")
    furniture_askew_deg: float = Field(
        0.0, ge=0.0, le=30.0, description="Standard deviation of the angle between cupboard and wall."
    )
    hide_vertex: bool = Field(False, description="A box hides the corner's vertex.")
    sphere_radius_m: float = Field(0.12, ge=0.05, le=0.2, description="Radius of the sphere.")
    ball_bar_m: float | None = Field(
        None,
        ge=0.15,
        le=5.0,
        description="Distance between the sphere's centre and a second one's; default: one sphere.",
    )
    albedo: float | None = Field(
        None,
        ge=0.05,
        le=0.95,
        description="Mean albedo of walls and floor; default: each its own, 0.35 to 0.8.",
    )
    refresh_hz: float = Field(60.0, ge=10.0, le=1000.0, description="Refresh rate of the projector.")
    pulsation: float = Field(
        0.0,
        ge=0.0,
        le=1.0,
        description="Relative pulsation of the light within a refresh period.",
    )
    wallpaper: bool = Field(False, description="Textured walls and floor, for photos.")
    ambient: float = Field(
        0.05,
        ge=0.0,
        le=10.0,
        description="Ambient light relative to the projector's white.",
    )
    interreflection: bool = Field(True, description="Surfaces light each other.")
    distortion: float = Field(
        1.0, ge=0.0, le=2.0, description="Factor on both lenses' random distortion; 0 for ideal lenses."
    )
    gamma: float = Field(2.2, ge=1.0, le=3.0, description="Gamma of the projector.")
    contrast: float = Field(1000.0, ge=10.0, description="The projector's white over its black.")
    ghost: float = Field(
        0.0,
        ge=0.0,
        le=0.9,
        description="Share of the previous picture in each frame.",
    )
    flicker: float = Field(
        0.0,
        ge=0.0,
        le=0.9,
        description="Largest relative deviation of a frame's brightness, whatever the exposure.",
    )
    rolling_shutter_ms: float = Field(
        0.0,
        ge=0.0,
        le=1000.0,
        description="Delay from the first row's exposure to the last one's; flicker then shows as bands.",
    )
    stripe_loss: float = Field(
        0.0,
        ge=0.0,
        le=0.5,
        description="Share of light that a one-pixel stripe loses by crosstalk; two pixels lose half of it.",
    )
    sharpening: float = Field(
        0.0,
        ge=0.0,
        le=3.0,
        description="Strength of the projector's sharpening (unsharp mask, 1 px).",
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
        0.5, ge=0.0, le=4.0, description="Standard deviation of the projector's blur, in its pixels."
    )
    camera_blur_px: float = Field(
        0.5, ge=0.0, le=3.0, description="Standard deviation of the camera's blur, in its pixels."
    )
    camera_response: Literal["linear", "srgb", "photo"] = Field(
        "linear",
        description="Response: machine vision, webcam, or a photo camera's JPEG.",
    )
    exposure_us: float | None = Field(
        None,
        gt=0.0,
        description="Exposure; default: white reaches 85 % of the range.",
    )
    bit_depth: Literal[8, 10, 12, 16] = Field(8, description="Bits per camera pixel.")
    full_well_electrons: float = Field(10_500.0, ge=100.0, description="Full well, which sets the shot noise.")
    read_noise_electrons: float = Field(2.5, ge=0.0, description="Standard deviation of the read noise.")

    @property
    def grid(self) -> PixelGrid:
        """Of the projector's pixels."""
        return PixelGrid(self.pixel_aspect, self.odd_rows)

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


class CameraRigSettings(Settings):
    """Settings of every rig of real devices: a projector that is a screen, and a camera of a backend."""

    slow: ClassVar[bool] = False  # a frame takes a second or longer

    backend: str
    exposure_us: float | None = None
    gain: float | None = None
    screen: int | str | None = Field(
        None,
        description="Number, name or geometry (`1920x1080+1920+0`) of the projector's screen, or its own X display "
        "(`:0.1`); default: the only one of the projector's size.",
    )
    refresh_hz: float | None = Field(
        None, ge=10.0, le=1000.0, description="Refresh rate of the projector; default: the screen mode's."
    )

    @property
    def has_gain(self) -> bool:
        """Whether the gain can be set."""
        return True

    @property
    def bytes_per_pixel(self) -> int:
        """Bytes per pixel of a frame."""
        return 3
