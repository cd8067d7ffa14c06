"""What can be configured about a GenICam camera."""

from typing import Any, Literal

from pydantic import Field, model_validator

from hw.settings import USUAL_EXPOSURE_US, CameraRigSettings


class AravisRigSettings(CameraRigSettings):
    """A GenICam camera (GigE Vision, USB3 Vision) reached through Aravis, and a projector that is a screen."""

    backend: Literal["aravis"]
    camera: str | None = Field(
        None, min_length=1, description="Id, serial number or IP address; left out, the only camera there is."
    )
    exposure_us: float = Field(
        USUAL_EXPOSURE_US,
        gt=0.0,
        le=10_000_000.0,
        description="Exposure in microseconds, rounded to a whole number of the projector's refresh periods.",
    )
    gain: float | None = Field(
        None, description="Gain in the camera's own unit (most use dB); left out, the camera's is kept."
    )
    pixel_format: str = Field("Mono8", description="Mono or Bayer format of 8 to 16 bits, by its GenICam name.")
    offset_px: tuple[int, int] | None = Field(
        None, description="(x, y) of the image on the sensor, in pixels after binning; left out, it is centred."
    )
    binning: int = Field(1, ge=1, le=8, description="Sensor pixels that are combined to one, in either direction.")
    trigger: Literal["software", "line", "free-run"] = Field(
        "software", description="What starts an exposure; free-running cameras have frames discarded."
    )
    trigger_line: str = Field("Line1", min_length=1, description="Input that triggers, for trigger: line.")
    packet_size: int | None = Field(
        None, ge=576, le=16_000, description="Bytes in a GigE Vision packet; left out, it is negotiated."
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
