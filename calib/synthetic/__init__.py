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
from calib.synthetic.networks import SyntheticNetwork, random_network, with_turned_camera
from calib.synthetic.photos import SyntheticPhotoOptions, SyntheticPhotos, random_photos
from calib.synthetic.rooms import RoomOptions, SyntheticRoom, SyntheticStation, cast, random_room, random_waves
from calib.synthetic.stations import (
    STATION_CAMERA,
    CloudErrors,
    FurnishedRoom,
    Paint,
    StationCloud,
    moved_rig,
    random_furnished_room,
    ring,
    seen_from,
)
