"""What is done to a cloud after a scan: named steps, in an order, each with its parameter."""

from pydantic import Field, model_validator

from hw.settings import Settings
from scanner.errors import InputError
from scanner.io import Flag, Number, Whole
from scanner.quantities import parse_coordinates, parse_length

MOST_STEPS = 64
_OF_TURNED_BOX = 6 + 9  # lengths, with those of its axes
_LARGEST = 1e12


class CloudStep(Settings):
    """One of these. Lengths are as in 5cm; without a unit they are in the result's, which may be the baseline."""

    box: str | None = Field(
        default=None,
        description="Keep what is between two corners, as in -0.5m,-0.3m,1m,0.5m,0.3m,2m, along the cloud's axes, or "
        "along axes of its own: nine lengths more, as of axes.",
    )
    outliers: Number | None = Field(
        default=None,
        ge=0.1,
        le=100,
        description="Drop points whose distance from their 20 neighbours is more standard deviations above the mean.",
    )
    pieces: str | Number | None = Field(default=None, description="Drop pieces of the cloud that are smaller.")
    smooth: Flag | None = Field(
        default=None, description="Move each point along its normal, as far as its standard deviation allows."
    )
    fill: str | Number | None = Field(default=None, description="Close holes of the mesh up to this size.")
    triangles: Whole | None = Field(
        default=None, ge=4, le=_LARGEST, description="Reduce the mesh to so many triangles."
    )
    floor: Flag | None = Field(
        default=None, description="Origin on the floor below the newest camera, z up, x to the camera's right."
    )
    axes: str | None = Field(
        default=None,
        description="Origin, a point on the x axis, and one beside it on the side of y: nine lengths, as of box.",
    )

    @model_validator(mode="after")
    def _exactly_one(self) -> "CloudStep":
        given = [name for name, value in self if value not in (None, False)]
        if len(given) != 1:
            names = ", ".join(CloudStep.model_fields)
            raise ValueError(f"a step is one of {names}, found {' and '.join(given) or 'none'}")
        return self

    @model_validator(mode="after")
    def _lengths_can_be_read(self) -> "CloudStep":
        try:
            if self.box is not None:
                parse_coordinates(self.box, "m", _OF_TURNED_BOX if self.box.count(",") + 1 == _OF_TURNED_BOX else 6)
            if self.axes is not None:
                parse_coordinates(self.axes, "m", 9)
            for length in (self.pieces, self.fill):
                if length is not None:
                    parse_length(str(length), "m")
        except InputError as error:
            raise ValueError(str(error)) from error
        return self

    @property
    def name(self) -> str:
        """Which of them it is."""
        return next(name for name, value in self if value not in (None, False))

    @property
    def parameter(self) -> str | float | int | bool:
        """What it is given."""
        parameter: str | float | int | bool = getattr(self, self.name)
        return parameter

    def __str__(self) -> str:
        parameter = self.parameter
        return self.name if parameter is True else f"{self.name} {parameter}"


class CloudSettings(Settings):
    """What exports and views leave of the cloud; `cloud.ply` itself stays as it was measured."""

    box: str | None = Field(
        default=None,
        description="The region of interest, a first step: two corners, as in -0.5m,-0.3m,1m,0.5m,0.3m,2m.",
    )
    steps: tuple[CloudStep, ...] = Field(
        default=(), max_length=MOST_STEPS, description="As in [{outliers: 3}, {pieces: 5cm}]."
    )

    @model_validator(mode="after")
    def _box_can_be_read(self) -> "CloudSettings":
        if self.box is not None:
            CloudStep(box=self.box)
        return self

    @property
    def all_steps(self) -> tuple[CloudStep, ...]:
        """The box, and the steps."""
        return self.steps if self.box is None else (CloudStep(box=self.box), *self.steps)
