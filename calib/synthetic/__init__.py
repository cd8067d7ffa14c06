"""Synthetic captures with ground truth, independent of the estimators' code."""

from calib.synthetic.boards import BoardOptions, SyntheticBoards, SyntheticView, random_boards
from calib.synthetic.captures import (
    PAPER_CAMERA,
    PAPER_PROJECTOR,
    CaptureOptions,
    SyntheticCapture,
    SyntheticPhotoOptions,
    SyntheticPhotos,
    look_at,
    random_capture,
    random_captures,
    random_photos,
)
from calib.synthetic.rooms import RoomOptions, SyntheticRoom, SyntheticStation, cast, random_room, random_waves
from calib.synthetic.stations import (
    STATION_CAMERA,
    CloudErrors,
    FurnishedRoom,
    Paint,
    StationCloud,
    SyntheticNetwork,
    moved_rig,
    random_furnished_room,
    random_network,
    ring,
    seen_from,
    with_turned_camera,
)
