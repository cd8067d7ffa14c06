"""Array types and matrices of the simulation."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from calib.numerics import Floats

Light = NDArray[np.float32]
Indices = NDArray[np.int64]


def sparse_matrix(rows: Indices, columns: Indices, values: Floats, shape: tuple[int, int]) -> sparse.csr_array:
    """A single-precision matrix with k entries, `columns` and `values` (n, k), in each of the `rows` (n,).

    Entries at the same place are added.
    """
    repeated = np.repeat(rows, columns.shape[1])
    return sparse.csr_array((values.astype(np.float32).ravel(), (repeated, columns.ravel())), shape=shape)
