"""Films a simulated room with a camera that nothing synchronises: the player, the projector, a phone, its encoder."""

from filming.camera import Camera, Clip, film
from filming.player import Played, play
