"""What can be chosen about the loopback rig."""

from pydantic import BaseModel, ConfigDict, Field

from hw.settings import SimulatedRigSettings


class Conditions(BaseModel):
    """What may change while the camera is there."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    latency_ms: float = Field(default=50.0, ge=0.0, le=500.0, description="How late light follows the screen.")
    jitter_ms: float = Field(default=0.0, ge=0.0, le=100.0, description="Every picture's light is later by up to this.")
    missed_refreshes: float = Field(
        default=0.0, ge=0.0, le=1.0, description="Share of the pictures that come a refresh of 60 Hz later than others."
    )
    settling_ms: float = Field(
        default=0.0, ge=0.0, le=100.0, description="Time constant in which a slow panel turns to the next picture."
    )
    lost_packets: float = Field(default=0.0, ge=0.0, le=1.0, description="Share of the stream's packets that get lost.")


class LoopbackSettings(BaseModel):
    """The camera of the loopback rig and the room that it looks at."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    camera_size: tuple[int, int] = Field(description="Width and height of the sensor in pixels.")
    room: SimulatedRigSettings = Field(
        default_factory=lambda: SimulatedRigSettings.model_validate({}), description="The room."
    )
    conditions: Conditions = Field(default=Conditions(), description="Those at the start.")
    white_exposure_us: float = Field(
        default=100_000 / 3, gt=0.0, description="Exposure at which white reaches 85 % of the range, without gain."
    )
    address: str = Field(default="127.0.0.1", description="Where the camera answers.")
    serial: str = Field(default="loopback", description="Its serial number.")
