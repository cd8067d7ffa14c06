"""What the residuals themselves say of their noise: beyond what independent matches would leave, and alike nearby."""

import numpy as np

from calib.arrays import Floats
from calib.cells import MEDIAN_LENGTH, Cells
from calib.likelihood import ROBUST_SIGMAS


def systematic(residual: Floats, sigma_px: Floats) -> float:
    """τ such that the residuals (M, 2) have the median size that variances σ² + τ² predict (robust, in px)."""
    low, high = 0.0, 2 * float(np.median(np.linalg.norm(residual, axis=1))) + 1e-12
    for _ in range(50):
        middle = (low + high) / 2
        size = np.linalg.norm(residual, axis=1) / np.sqrt(sigma_px**2 + middle**2)
        low, high = (middle, high) if np.median(size) > MEDIAN_LENGTH else (low, middle)
    return high if high > 1e-3 * float(np.median(sigma_px)) else 0.0


def inflation(cells: Cells, whitened: Floats) -> float:
    """Variance inflation κ = ((1 + ρ) / (1 − ρ))² of a field with correlation ρ to the next cell in both directions."""
    clipped = np.clip(whitened, -ROBUST_SIGMAS, ROBUST_SIGMAS)
    width = int(cells.column.max()) + 2
    height = int(cells.row.max()) + 2
    key = (cells.plane.astype(np.int64) * height + cells.row) * width + cells.column
    order = np.argsort(key)
    products = []
    for step in (1, width):
        place = np.minimum(np.searchsorted(key[order], key + step), len(key) - 1)
        neighbour = order[place]
        found = key[neighbour] == key + step
        products.append(np.sum(clipped[found] * clipped[neighbour[found]], axis=1) / 2)
    power = float(np.mean(clipped**2))
    pairs = np.concatenate(products)
    rho = float(np.mean(pairs)) / power if len(pairs) and power > 0 else 0.0
    rho = min(max(rho, 0.0), 0.9)
    return ((1 + rho) / (1 - rho)) ** 2
