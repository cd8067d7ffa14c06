"""Synthetic captures with ground truth, independent of the estimators' code."""

from calib.synthetic.boards import BoardOptions, SyntheticBoards, SyntheticView, random_boards
from calib.synthetic.captures import (
    PAPER_CAMERA,
    PAPER_PROJECTOR,
    CaptureOptions,
    SyntheticCapture,
    look_at,
    random_capture,
    random_captures,
)
from calib.synthetic.networks import SyntheticNetwork, random_network
from calib.synthetic.photos import PhotoOptions, SyntheticPhotos, random_photos
from calib.synthetic.rooms import RoomOptions, SyntheticRoom, SyntheticStation, random_room
