"""A simulated room, its light, and a camera and a projector in it.

Nothing here depends on patterns, decoding or calibration: the projector shows a picture, and the camera sees the room
that it lights. Vectors are stored component first, (3, n), in metres. The world's origin is the vertex of the corner, z
is up, and the room is where all coordinates are positive.
"""

from hw.simulated.arrays import Light
from hw.simulated.device import Optics, PlacedDevice
from hw.simulated.illumination import ProjectorLight
from hw.simulated.picture import PictureOptics, Sensor, panel_homography
from hw.simulated.placement import draw_camera_pose, look, look_at
from hw.simulated.rig import Scenery, SimulatedCamera, SimulatedProjector
from hw.simulated.room import DrawnRoom, draw_room
from hw.simulated.scene import Label, Scene
from hw.simulated.shapes import Block
from hw.simulated.simulation import GroundTruth, SimulatedRoom, place_room, true_calibration
from hw.simulated.texture import Texture, paint
