"""Matches between camera and projector pixels."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib.numerics import Bools, Floats, Ints, in_slices

FACES = (0, 1, 2)
NO_FACE = -1
# Matches checked at a time; the check keeps no intermediate arrays in the processor's cache.
_PIECE = 1 << 19


@dataclass(frozen=True)
class Matches:
    """Corresponding points.

    Millions of matches may be stored in single precision if the decoder is no more accurate. Indexing converts to
    double precision for arithmetic.

    Raises ValueError if shapes differ or a number is not finite.
    """

    camera_px: Floats
    """(N, 2)."""
    projector_px: Floats
    """(N, 2)."""
    face: Ints | None = None
    """Labels (N,), `NO_FACE` for points on none of them (the default); 0, 1, 2 are the corner's faces."""
    sigma_px: Floats | None = None
    """Standard deviation (N,) of each coordinate of `projector_px`, or None."""

    def __post_init__(self) -> None:
        n = len(self.camera_px)
        for name, value, shape in (
            ("camera_px", self.camera_px, (n, 2)),
            ("projector_px", self.projector_px, (n, 2)),
            ("face", self.face, (n,)),
            ("sigma_px", self.sigma_px, (n,)),
        ):
            if value is None:
                continue
            if value.shape != shape:
                raise ValueError(f"{name} must have the shape {shape}, found {value.shape}")
            if not _is_finite(value):
                raise ValueError(f"{name} must hold finite numbers, found NaN or infinity")
        sigma = self.sigma_px
        if sigma is not None and n and not sigma.min() > 0:
            raise ValueError("sigma_px must be positive")

    def __len__(self) -> int:
        return len(self.camera_px)

    def __getitem__(self, chosen: Bools | Ints | slice) -> "Matches":
        """The matches at a mask, indices or a slice, in double precision."""
        if not isinstance(chosen, slice) and chosen.dtype == np.bool_:
            chosen = np.flatnonzero(chosen)  # several times as fast as the mask itself
        return Matches(
            self.camera_px[chosen].astype(np.float64, copy=False),
            self.projector_px[chosen].astype(np.float64, copy=False),
            None if self.face is None else self.face[chosen],
            None if self.sigma_px is None else self.sigma_px[chosen].astype(np.float64, copy=False),
        )

    @property
    def labels(self) -> Ints:
        """Return `face` (N,). Raises ValueError if the matches have no labels."""
        if self.face is None:
            raise ValueError("these matches have no face labels")
        return self.face

    @cached_property
    def on_each_face(self) -> Ints:
        """Number of matches (3,) on each face of the corner; zero without labels."""
        face = np.full(0, NO_FACE) if self.face is None else self.face

        def counted(at: slice) -> list[int]:
            return [int(np.count_nonzero(face[at] == label)) for label in FACES]

        counts: Ints = np.array(in_slices(len(face), _PIECE, counted)).sum(axis=0)
        return counts

    def with_faces(self, face: Ints) -> "Matches":
        """The same matches with other face labels (N,)."""
        return replace(self, face=face)

    def on_face(self, label: int) -> "Matches":
        """The matches with one face label."""
        return self[self.labels == label]


def _is_finite(values: Floats | Ints) -> bool:
    """Return whether all numbers (N, …) are finite; checked in pieces, as there may be millions."""
    if np.issubdtype(values.dtype, np.integer):
        return True

    def is_finite(at: slice) -> bool:
        # A finite sum of squares, read in one pass, has none but finite terms; an infinite one may have overflowed.
        return bool(np.isfinite(np.vdot(values[at], values[at]))) or bool(np.isfinite(values[at]).all())

    return all(in_slices(len(values), _PIECE, is_finite))
