"""Segment matches into planes and select the three planes that are the faces of a corner."""

from calib.plane_segmentation.faces import Faces, find_faces
from calib.plane_segmentation.segmentation import NO_PLANE
from calib.plane_segmentation.sparse_faces import find_same_faces, find_sparse_faces
