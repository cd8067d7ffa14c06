"""What can be chosen about the loopback rig."""

from typing import Literal

from pydantic import Field

from hw.settings import USUAL_EXPOSURE_US, Settings, SimulatedRigSettings


class Conditions(Settings):
    """Conditions that may change while the camera runs."""

    latency_ms: float = Field(default=50.0, ge=0.0, le=500.0, description="How late light follows the screen.")
    jitter_ms: float = Field(default=0.0, ge=0.0, le=100.0, description="Every picture's light is later by up to this.")
    missed_refreshes: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Share of the pictures that come a refresh of 60 Hz later than others."
    )
    settling_ms: float = Field(
        default=0.0, ge=0.0, le=100.0, description="Time constant in which a slow panel turns to the next picture."
    )
    lost_packets: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Share of a GigE Vision camera's packets that get lost."
    )
    sending_jitter_ms: float = Field(
        default=0.0, ge=0.0, le=1000.0, description="Every frame of a webcam leaves later by up to this."
    )
    dropped_frames: float = Field(default=0.0, ge=0.0, le=1.0, description="Share of a webcam's frames that get lost.")
    repeated_frames: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Share of a webcam's frames that are sent twice."
    )
    automatic_exposure: bool = Field(default=False, description="A webcam chooses its exposure by itself.")
    fault: Literal["", "frozen", "silent", "rotated", "grey"] = Field(
        default="", description="What is wrong with a webcam's frames."
    )


class WebcamSettings(Settings):
    """Properties of a webcam, which is served as Motion JPEG at http://ADDRESS:PORT/video."""

    port: int = Field(ge=1, le=65535, description="Where it is served.")
    frames_per_s: float = Field(default=30.0, gt=0.0, le=240.0, description="Its rate.")
    jpeg_quality: int = Field(default=80, ge=1, le=100, description="Quality as libjpeg counts it.")
    readout_ms: float = Field(
        default=12.0, ge=0.0, le=100.0, description="From the first row's exposure to the last's."
    )
    queue: int = Field(default=3, ge=0, le=30, description="Frames that wait before one leaves.")


class LoopbackSettings(Settings):
    """The camera of the loopback rig and the room that it looks at."""

    camera_size: tuple[int, int] = Field(description="Width and height of the sensor in pixels.")
    room: SimulatedRigSettings = Field(
        default_factory=lambda: SimulatedRigSettings.model_validate({}), description="The room."
    )
    projector_poses: tuple[int, ...] = Field(
        default=(), description="Places of several projectors, one for each screen; without any, the room's own."
    )
    conditions: Conditions = Field(default=Conditions(), description="Those at the start.")
    white_exposure_us: float = Field(
        default=USUAL_EXPOSURE_US,
        gt=0.0,
        description="At it, white reaches 85 % of the range, without gain.",
    )
    address: str = Field(default="127.0.0.1", description="Where the camera answers.")
    serial: str = Field(default="loopback", description="Its serial number.")
    webcam: WebcamSettings | None = Field(default=None, description="A webcam in place of the GigE Vision camera.")
