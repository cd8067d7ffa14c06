"""Units of length in results, on the command line, and for reading, with as many digits as are worth showing."""

import re
from dataclasses import dataclass
from math import floor, log10

from scanner.errors import InputError
from scanner.io import LONGEST_M, SHORTEST_M
from scanner.quantities.calibration_numbers import plain
from scanner.shown_text import shown

UNKNOWN_UNIT = "baseline"
METRES = {
    "m": 1.0,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "µm": 1e-6,  # the micro sign …
    "μm": 1e-6,  # … and the Greek letter
    "in": 0.0254,
    "ft": 0.3048,
}
_LENGTH = re.compile(r"([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?) *([^0-9. ]*)")


def metres_per(unit: str) -> float:
    """Return the length of a unit in metres. Raises InputError if it is unknown, as is that of a result without a
    scale.
    """
    if unit == UNKNOWN_UNIT:
        raise InputError(
            "the result has no known length, its unit is the baseline; make it again with a scale, as in "
            "--set scale.baseline_m=0.4"
        )
    if unit not in METRES:
        raise InputError(f"the unit '{unit}' is not known; expected one of: {', '.join(METRES)}")
    return METRES[unit]


def unit_name(unit: str) -> str:
    """A unit in a sentence."""
    return "baselines" if unit == UNKNOWN_UNIT else unit


def parse_length(text: str, unit: str) -> float:
    """'50.8mm', or a number in `unit` → the length in `unit`.

    Raises InputError for anything else, a length that nothing here has, and a unit that cannot be converted.
    """
    match = _LENGTH.fullmatch(text.strip())
    if match is None or not float(match[1]) > 0:
        raise InputError(f"expected a length like 50.8mm, or a number in the result's unit, found '{text}'")
    number, given = float(match[1]), match[2] or unit
    if not SHORTEST_M <= number * METRES.get(given, 1.0) <= LONGEST_M:
        limits = f"{SHORTEST_M:g} to {LONGEST_M:g} {'m' if given in METRES else unit_name(given)}"
        raise InputError(f"expected a length of {limits}, found {shown(text)}")
    if given == unit:
        return number
    if given not in METRES:
        raise InputError(f"'{text}': the unit '{given}' is not known; expected one of: {', '.join(METRES)}")
    if unit == UNKNOWN_UNIT:
        raise InputError(
            f"'{text}' cannot be compared with this result, whose unit is the baseline, because no length was known: "
            "make it again with a scale, as in --set scale.baseline_m=0.4, or give the length in baselines, without "
            "a unit"
        )
    return number * METRES[given] / metres_per(unit)


def parse_coordinates(text: str, unit: str, count: int) -> tuple[float, ...]:
    """'-0.5m,0,20cm' → `count` numbers in `unit`. Raises InputError for anything else."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != count:
        raise InputError(f"expected {count} lengths with commas between them, found {shown(text)}")
    return tuple(_parse_coordinate(part, unit) for part in parts)


def _parse_coordinate(text: str, unit: str) -> float:
    """A length of either sign, or 0, with or without a unit."""
    size = text.removeprefix("-")
    zero = _LENGTH.fullmatch(size)
    if zero is not None and float(zero[1]) == 0:
        return 0.0
    length = parse_length(size, unit)
    return -length if text.startswith("-") else length


def parse_seconds(option: str, text: str) -> float:
    """'0.2s', or a number → seconds. Raises InputError that names the `option`."""
    try:
        return float(text.removesuffix("s"))
    except ValueError as error:
        raise InputError(f"{option} {shown(text)}: expected seconds, as in 0.2s") from error


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

    def stated(self, value: float) -> str:
        """'0.1 mm', of a length that somebody stated: no digits but theirs."""
        return f"{value * self.factor:.6g} {self.name}"

    def measured(self, value: float, sigma: float | None = None) -> str:
        """The same without the unit."""
        value *= self.factor
        if not sigma:
            return plain(value, _decimals(value, 5))
        decimals = _decimals(sigma * self.factor, 2)
        return f"{plain(value, decimals)} ± {plain(sigma * self.factor, decimals)}"

    def error(self, value: float, *, signed: bool = False, beside: float | None = None) -> str:
        """'0.0123 mm'."""
        return f"{self.number(value, signed=signed, beside=beside)} {self.name}"

    def number(self, value: float, *, signed: bool = False, beside: float | None = None) -> str:
        """'0.0123': three significant digits, or the digits of a value that it stands `beside`."""
        decimals = _decimals(self.factor * (value if beside is None else beside), _SIGNIFICANT)
        return plain(self.factor * value, decimals, signed=signed)


def shown_unit(unit: str) -> ShownUnit:
    """Return the unit in which lengths of a result in `unit` are shown."""
    if unit in _METRIC:
        return ShownUnit(METRES[unit] / METRES["mm"], "mm")
    return ShownUnit(1.0, unit_name(unit))


def fine_unit(unit: str) -> ShownUnit:
    """The unit for deviations of surfaces, a thousandth of a millimetre or a millionth of the baseline."""
    if unit in _METRIC:
        return ShownUnit(METRES[unit] / METRES["µm"], "µm")
    return ShownUnit(1e6, "ppm of the baseline") if unit == UNKNOWN_UNIT else shown_unit(unit)


def _decimals(value: float, significant: int) -> int:
    return max(0, significant - 1 - floor(log10(abs(value)))) if value else 0
