"""Lengths for reading: in millimetres where the result is metric, with as many digits as are worth showing."""

from dataclasses import dataclass
from math import floor, log10

from scanner.quantities.calibration_numbers import plain
from scanner.quantities.units import METRES, unit_name

_METRIC = ("m", "cm", "mm")
_SIGNIFICANT = 3


@dataclass(frozen=True)
class ShownUnit:
    """`factor` takes a length in the result's unit to the unit that is shown, `name`."""

    factor: float
    name: str

    def length(self, value: float, sigma: float | None = None) -> str:
        """'50.812 ± 0.013 mm'; five significant digits without a sigma."""
        return f"{self.measured(value, sigma)} {self.name}"

    def measured(self, value: float, sigma: float | None = None) -> str:
        """The same without the unit."""
        value *= self.factor
        if not sigma:
            return plain(value, _decimals(value, 5))
        decimals = _decimals(sigma * self.factor, 2)
        return f"{plain(value, decimals)} ± {plain(sigma * self.factor, decimals)}"

    def error(self, value: float, *, signed: bool = False) -> str:
        """'0.0123 mm'."""
        return f"{self.number(value, signed=signed)} {self.name}"

    def number(self, value: float, *, signed: bool = False) -> str:
        """'0.0123': three significant digits."""
        value *= self.factor
        return plain(value, _decimals(value, _SIGNIFICANT), signed=signed)


def shown_unit(unit: str) -> ShownUnit:
    """Return the unit in which lengths of a result in `unit` are shown."""
    if unit in _METRIC:
        return ShownUnit(METRES[unit] / METRES["mm"], "mm")
    return ShownUnit(1.0, unit_name(unit))


def _decimals(value: float, significant: int) -> int:
    return max(0, significant - 1 - floor(log10(abs(value)))) if value else 0
