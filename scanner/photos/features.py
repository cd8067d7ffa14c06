"""Two photos → matches: SIFT features that choose each other and agree with one epipolar geometry."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calib.geometry import Matches
from calib.numerics import Bools, Floats, Ints
from calib.numerics import Image as Pixels
from calib.refusal import TOO_FEW_MATCHES, RefusalError

_MOST_FEATURES = 8_000
_CHUNK = 1000
# SIFT keeps a dozen copies of four times as many values: 40 GB for 200 megapixels. Lenses resolve a fraction of them.
_MOST_SEARCHED_PX = 25_000_000
_RATIO = 0.8  # Lowe 2004, section 7.1
_ROOT_EPSILON = 1e-7
_LIMIT_OF_WIDTH = 0.0015
_RANSAC_STEPS, _CONFIDENCE = 20_000, 0.9999
_FEWEST = 60
_LEAST_SIGMA_PX, _SIGMA_OF_SIZE = 0.1, 0.02


Descriptors = NDArray[np.float32]


@dataclass(frozen=True)
class Features:
    """`pixels` (N, 2), `size_px` (N,) and `descriptors` (N, 128), of unit length, of a photo of `width`."""

    pixels: Floats
    size_px: Floats
    descriptors: Descriptors
    width: int


def find_features(photo: Pixels) -> Features:
    """SIFT features (Lowe 2004), at most one at a place, described by RootSIFT (Arandjelović & Zisserman 2012)."""
    grey = photo if photo.ndim == 2 else cv2.cvtColor(photo, cv2.COLOR_BGR2GRAY)
    full_width, scale = grey.shape[1], max(1.0, float(np.sqrt(grey.size / _MOST_SEARCHED_PX)))
    if scale > 1:
        grey = cv2.resize(grey, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
    # Without precise upscaling, features of different sizes are shifted by different fractions of a pixel.
    detector = cv2.SIFT.create(nfeatures=_MOST_FEATURES, contrastThreshold=0.02, enable_precise_upscale=True)
    keypoints, descriptors = detector.detectAndCompute(grey, None)
    if not keypoints:
        return Features(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 128), np.float32), full_width)
    # Back to the full photo, by the ratio of the rounded sizes in x and y.
    steps = np.array([full_width / grey.shape[1], photo.shape[0] / grey.shape[0]])
    pixels = (np.array([keypoint.pt for keypoint in keypoints], np.float64) + 0.5) * steps - 0.5
    # A position with several orientations has several features; it counts once, or its error would count twice.
    _, first = np.unique(np.round(pixels, 2), axis=0, return_index=True)
    first.sort()
    chosen = descriptors[first]
    root = np.sqrt(chosen / (chosen.sum(axis=1, keepdims=True) + _ROOT_EPSILON))
    size = np.array([keypoint.size for keypoint in keypoints], np.float64) * scale
    return Features(pixels[first], size[first], root.astype(np.float32), full_width)


def match_features(first: Features, second: Features) -> Matches:
    """Matches that pass Lowe's ratio test, are mutual, and agree with one fundamental matrix (MAGSAC++); maybe none."""
    pairs = _mutual(first, second)
    a, b = first.pixels[pairs[:, 0]], second.pixels[pairs[:, 1]]
    agreeing = _agreeing(a, b, _LIMIT_OF_WIDTH * first.width) if len(pairs) >= _FEWEST else np.zeros(len(pairs), bool)
    size = np.maximum(first.size_px[pairs[:, 0]], second.size_px[pairs[:, 1]])
    # The position of a large blob is less accurate than that of a small one (Zeisl et al. 2009).
    sigma = np.hypot(_LEAST_SIGMA_PX, _SIGMA_OF_SIZE * size)
    order = np.flatnonzero(agreeing)
    order = order[np.lexsort((a[order, 0], np.rint(a[order, 1])))]
    return Matches(a[order], b[order], sigma_px=sigma[order])


def refuse_unrelated(matches: Matches, first: Features, second: Features) -> None:
    """Raise RefusalError where too few match: photos of different scenes, or with nothing to match on them."""
    if len(matches) < _FEWEST:
        raise RefusalError(
            TOO_FEW_MATCHES,
            f"Only {len(matches)} features of the photos match, of {len(first.pixels):,} and "
            f"{len(second.pixels):,} that were found; at least {_FEWEST} are needed.",
            "Give photos of the same corner, sharp, from places not too far apart, with texture on all three faces; or "
            "matches of another program (--matches).",
            {"matches": float(len(matches)), "needed_matches": float(_FEWEST)},
        )


def _mutual(first: Features, second: Features) -> Ints:
    """Index pairs (M, 2) of descriptors that are each other's nearest and pass the ratio test there."""
    if min(len(first.pixels), len(second.pixels)) < 2:
        return np.zeros((0, 2), np.int64)
    there, clear = _nearest(first.descriptors, second.descriptors)
    back, _ = _nearest(second.descriptors, first.descriptors)
    chosen = np.flatnonzero(clear & (back[there] == np.arange(len(there))))
    return np.stack([chosen, there[chosen]], axis=1)


def _nearest(these: Descriptors, candidates: Descriptors) -> tuple[Ints, Bools]:
    """For each descriptor (N,) of unit length the nearest of the others, and whether it is clearly the nearest."""
    nearest, clear = [], []
    for start in range(0, len(these), _CHUNK):
        square = np.maximum(2 - 2 * these[start : start + _CHUNK] @ candidates.T, 0.0)
        chosen = np.argmin(square, axis=1)
        rows = np.arange(len(chosen))
        best = square[rows, chosen]
        square[rows, chosen] = np.inf
        nearest.append(chosen)
        clear.append(best < _RATIO**2 * square.min(axis=1))
    return np.concatenate(nearest), np.concatenate(clear)


def _agreeing(a: Floats, b: Floats, limit_px: float) -> Bools:
    cv2.setRNGSeed(0)
    _, mask = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, limit_px, _CONFIDENCE, _RANSAC_STEPS)
    return np.zeros(len(a), bool) if mask is None else mask.ravel().astype(bool)
