"""What can be configured about a rig. The field descriptions become the configuration reference."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class SimulatedRigSettings(BaseModel):
    """A simulated room with a simulated projector and camera in it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    backend: Literal["simulated"] = "simulated"
    seed: int = Field(0, ge=0, description="Draws the room, its furniture, the rig and the places it looks from.")
    pose: int = Field(
        0,
        ge=0,
        le=7,
        description="Which of the places in the room the rig looks at the corner from; room and rig stay the same.",
    )
    walls_off_deg: float = Field(
        0.0, ge=0.0, le=10.0, description="Standard deviation of each of the corner's three angles from 90 degrees."
    )
    furniture: bool = Field(True, description="Boxes, a cupboard and a sphere, which hide and shade parts of the room.")
    hide_vertex: bool = Field(False, description="A box stands in the corner and hides its vertex from the camera.")
    sphere_radius_m: float = Field(0.12, ge=0.05, le=0.2, description="Radius of the sphere in metres.")
    albedo: float | None = Field(
        None,
        ge=0.05,
        le=0.95,
        description="Mean share of light that walls and floor reflect; left out, each has its own (0.35 to 0.8).",
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
    projector_blur_px: float = Field(
        0.5, ge=0.0, le=3.0, description="Standard deviation of the projector lens's blur in projector pixels."
    )
    camera_blur_px: float = Field(
        0.5, ge=0.0, le=3.0, description="Standard deviation of the camera lens's blur in camera pixels."
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


# What `rig:` in a configuration may be.
RigSettings = SimulatedRigSettings
