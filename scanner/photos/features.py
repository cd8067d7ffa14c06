"""Two photos → matches: SIFT features that choose each other and agree with one epipolar geometry."""

from dataclasses import dataclass

import cv2
import numpy as np

from calib.arrays import Floats
from calib.arrays import Image as Pixels
from calib.matches import Matches
from calib.refusal import RefusalError

_MOST_FEATURES = 12_000
_RATIO = 0.8  # Lowe 2004, section 7.1
_ROOT_EPSILON = 1e-7
_LIMIT_OF_WIDTH = 0.0015
_RANSAC_STEPS, _CONFIDENCE = 20_000, 0.9999
_FEWEST = 60


@dataclass(frozen=True)
class Features:
    """`pixels` (N, 2) and `descriptors` (N, 128) of a photo of `width`."""

    pixels: Floats
    descriptors: np.ndarray
    width: int


def find_features(photo: Pixels) -> Features:
    """SIFT features (Lowe 2004), at most one at a place, described by RootSIFT (Arandjelović & Zisserman 2012)."""
    grey = photo if photo.ndim == 2 else cv2.cvtColor(photo, cv2.COLOR_BGR2GRAY)
    keypoints, descriptors = cv2.SIFT_create(nfeatures=_MOST_FEATURES, contrastThreshold=0.02).detectAndCompute(
        grey, None
    )
    if descriptors is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32), grey.shape[1])
    pixels = np.array([keypoint.pt for keypoint in keypoints], np.float64)
    # A place with several orientations has several features; counted once, or its error would count twice.
    _, first = np.unique(np.round(pixels, 2), axis=0, return_index=True)
    first.sort()
    chosen = descriptors[first]
    root = np.sqrt(chosen / (chosen.sum(axis=1, keepdims=True) + _ROOT_EPSILON))
    return Features(pixels[first], root, grey.shape[1])


def match_features(first: Features, second: Features) -> Matches:
    """Matches that pass Lowe's ratio test, are mutual, and agree with one fundamental matrix (MAGSAC++); maybe none."""
    pairs = _mutual(first, second)
    a, b = first.pixels[pairs[:, 0]], second.pixels[pairs[:, 1]]
    agreeing = _agreeing(a, b, _LIMIT_OF_WIDTH * first.width) if len(pairs) >= _FEWEST else np.zeros(len(pairs), bool)
    order = np.lexsort((a[agreeing, 0], np.rint(a[agreeing, 1])))
    return Matches(a[agreeing][order], b[agreeing][order])


def refuse_unrelated(matches: Matches, first: Features, second: Features) -> None:
    """Raise RefusalError where too few match: photos of different scenes, or with nothing to match on them."""
    if len(matches) < _FEWEST:
        raise RefusalError(
            f"Only {len(matches)} features of the photos belong together, of {len(first.pixels):,} and "
            f"{len(second.pixels):,} that were found; at least {_FEWEST} are needed.",
            "Give photos of the same corner, sharp, from places not too far apart, with texture on all three faces; or "
            "matches of another program (--matches).",
        )


def _mutual(first: Features, second: Features) -> np.ndarray:
    """Index pairs (M, 2) of descriptors that are each other's nearest and pass the ratio test there."""
    if min(len(first.pixels), len(second.pixels)) < 2:
        return np.zeros((0, 2), np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    there = {
        best.queryIdx: best.trainIdx
        for best, next_best in matcher.knnMatch(first.descriptors, second.descriptors, k=2)
        if best.distance < _RATIO * next_best.distance
    }
    back = {best.queryIdx: best.trainIdx for best in matcher.match(second.descriptors, first.descriptors)}
    return np.array([(a, b) for a, b in there.items() if back.get(b) == a], np.int64).reshape(-1, 2)


def _agreeing(a: Floats, b: Floats, limit_px: float) -> np.ndarray:
    cv2.setRNGSeed(0)
    _, mask = cv2.findFundamentalMat(a, b, cv2.USAC_MAGSAC, limit_px, _CONFIDENCE, _RANSAC_STEPS)
    return np.zeros(len(a), bool) if mask is None else mask.ravel().astype(bool)
