"""A small simulated room, filmed while a player shows the video of a sequence."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from filming.camera import Camera, Clip, film
from filming.player import Played, play

from calib.geometry import Size
from calib.numerics import Image
from hw.settings import SimulatedRigSettings
from hw.simulated import Light, SimulatedRoom
from scanner.patterns import PRESETS, write_sequence
from scanner.recordings import Programme, programme_of, write_player_video

CAMERA, PROJECTOR = (384, 216), (256, 144)
BIT_RATE = 1.5e6


@dataclass
class FilmedRoom:
    """`folder` receives the video, its sequence.yaml and the recordings; pictures last `hold_s`."""

    folder: Path
    hold_s: float = 0.1
    seen: dict[bytes, Light] = field(default_factory=dict)

    @cached_property
    def room(self) -> SimulatedRoom:
        settings = SimulatedRigSettings(furniture=False, interreflection=False)
        return SimulatedRoom(settings, CAMERA, PROJECTOR)

    @cached_property
    def programme(self) -> Programme:
        return programme_of(PRESETS["quick"].patterns(PROJECTOR), Size(*PROJECTOR), self.hold_s, 1)

    @cached_property
    def sequence(self) -> Path:
        write_sequence(self.folder, self.programme.patterns, PROJECTOR, video=self.programme.as_dict("video.mp4"))
        return self.folder / "sequence.yaml"

    @cached_property
    def played(self) -> Played:
        path = self.folder / "video.mp4"
        write_player_video(path, self.programme)
        return play(path)

    def light_of(self, picture: Image) -> Light:
        key = picture.tobytes()
        if key not in self.seen:
            full_well = np.float32(self.room.settings.full_well_electrons)
            self.seen[key] = self.room.electrons(picture) / full_well
        return self.seen[key]

    def film(self, name: str, camera: Camera, start_s: float = 0.7, length_s: float | None = None) -> Path:
        path = self.folder / name
        clip = Clip(start_s, length_s or self.played.length_s - start_s)
        film(path, self.played, self.light_of, camera, clip)
        return path
