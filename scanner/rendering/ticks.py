"""Round numbers along an axis."""

from math import ceil, floor, log10


def even_ticks(low: float, high: float, most: int) -> list[float]:
    """Multiples of 1, 2 or 5 times a power of ten from `low` to `high` > `low`, about `most` at most."""
    rough = (high - low) / most
    power = 10.0 ** floor(log10(rough))
    step = next(digit * power for digit in (1, 2, 5, 10) if digit * power >= rough)
    return [k * step for k in range(ceil(low / step), floor(high / step) + 1)]


def tick_text(tick: float) -> str:
    """The label of a tick."""
    return f"{tick:.6g}".replace("-", "−")
