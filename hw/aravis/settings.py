"""What can be configured about a GenICam camera."""

from typing import Any, Literal

from pydantic import Field, model_validator

from hw.settings import USUAL_EXPOSURE_US, CameraRigSettings


class AravisRigSettings(CameraRigSettings):
    """A GenICam camera (GigE Vision, USB3 Vision) reached through Aravis, and a projector that is a screen."""

    backend: Literal["aravis"]
    camera: str | None = Field(
        None, min_length=1, description="Id, serial number or IP address; default: the only camera."
    )
    exposure_us: float = Field(
        USUAL_EXPOSURE_US,
        gt=0.0,
        le=10_000_000.0,
        description="Exposure, rounded to whole refresh periods of the projector.",
    )
    gain: float | None = Field(None, description="Gain in the camera's unit, usually dB; default: unchanged.")
    pixel_format: str = Field("Mono8", description="GenICam name of a Mono or Bayer format, 8 to 16 bits.")
    offset_px: tuple[int, int] | None = Field(
        None, description="Image's offset on the sensor, in binned pixels; default: centred."
    )
    binning: int = Field(1, ge=1, le=8, description="Sensor pixels combined into one, in each direction.")
    trigger: Literal["software", "line", "free-run"] = Field(
        "software", description="What starts an exposure; with `free-run`, surplus frames are discarded."
    )
    trigger_line: str = Field("Line1", min_length=1, description="Input for `trigger: line`.")
    packet_size: int | None = Field(
        None, ge=576, le=16_000, description="Bytes per GigE Vision packet; default: negotiated."
    )

    @property
    def bytes_per_pixel(self) -> int:
        """Of a frame; those of colour cameras have three channels."""
        channels = 1 if self.pixel_format.startswith("Mono") else 3
        return channels * (1 if self.pixel_format.endswith("8") else 2)

    @model_validator(mode="before")
    @classmethod
    def _camera_by_number(cls, data: Any) -> Any:
        """Serial numbers look like numbers in YAML."""
        if isinstance(data, dict) and type(data.get("camera")) is int:
            return data | {"camera": str(data["camera"])}
        return data
