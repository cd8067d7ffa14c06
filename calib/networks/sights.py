"""A plane lit by one projector and seen by one camera: what a network predicts of its cells, and how that changes."""

from dataclasses import dataclass

import numpy as np

from calib.geometry import PER_PLANE, Plane, Pose, cross_matrix, tangent_basis
from calib.networks.network import PER_NODE, PER_WARP, WARP, Device, Network
from calib.numerics import Floats, Ints
from calib.refinement import PER_DEVICE, Cells

PER_SIGHT = 2 * PER_NODE + PER_PLANE
_AXES = np.eye(3)


@dataclass(frozen=True, eq=False)
class PlaneObservation:
    """The `cells` of one plane that `camera` sees in the light of `projector`; all by number in the network.

    `capture`: number of the pair.
    """

    capture: int
    camera: int
    projector: int
    plane: int
    cells: Cells

    def columns(self, network: Network) -> Ints:
        """The network's columns that it depends on, (39,): the camera's, the projector's, the plane's."""
        every = np.arange(network.size, dtype=np.int32)
        return np.concatenate(
            [
                every[network.device_columns(self.camera)],
                every[network.device_columns(self.projector)],
                every[network.plane_columns(self.plane)],
            ]
        )

    def carried(self, _: Network) -> Floats:
        """Its own columns are those of the network, (39, 39)."""
        return np.eye(PER_SIGHT)

    def points(self, network: Network) -> Floats:
        """Where the rays of its cells meet the plane, (M, 3) in the network's frame."""
        camera = network.devices[self.camera]
        return points_on(self.cells.camera_px, camera, network.planes[self.plane])

    def predict(self, network: Network, camera_px: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Projector pixels (N, 2) of its cells, or of `camera_px`, their Jacobian (N, 2, 39), and depths (N, 2).

        A point stays on the plane: moved by v it slides back along its ray u, n · u = 1, by u (n · v).
        """
        camera, projector = network.devices[self.camera], network.devices[self.projector]
        plane = network.planes[self.plane]
        rays, by_lens, by_warp = camera.rays(self.cells.camera_px if camera_px is None else camera_px)
        along, depth = _meet(rays, camera.pose, plane)
        off = along * plane.offset_from(camera.pose.translation)
        points = off + camera.pose.translation
        onto = np.eye(3) - along[:, :, None] * plane.normal
        tilts = -along[:, :, None] * (points @ tangent_basis(plane.normal))[:, None]
        onto_plane = depth[:, None, None] * (onto @ camera.pose.rotation)
        moved = np.concatenate(
            [
                onto_plane @ by_lens,
                -onto @ cross_matrix(off),
                onto,
                onto_plane @ by_warp,
                np.zeros((len(rays), 3, PER_DEVICE)),
                cross_matrix(points - projector.pose.translation),
                np.broadcast_to(-_AXES, onto.shape),
                np.zeros((len(rays), 3, PER_WARP)),
                tilts,
                along[:, :, None],
            ],
            axis=2,
        )
        before = projector.pose.undo(points)
        pixels, by_point, by_lens, by_warp = projector.pixels(before)
        jacobian = by_point @ (projector.pose.rotation.T @ moved)
        of_projector = jacobian[:, :, PER_NODE:]
        of_projector[:, :, :PER_DEVICE] += by_lens
        of_projector[:, :, WARP] += by_warp
        return pixels, jacobian, np.stack([depth, before[:, 2]], axis=1)


def points_on(pixels: Floats, device: Device, plane: Plane) -> Floats:
    """Where the rays of a device's pixels (N, 2) meet a plane, (N, 3) in the room's frame."""
    rays, _, _ = device.rays(pixels)
    _, depth = _meet(rays, device.pose, plane)
    return device.pose @ (rays * depth[:, None])


def _meet(rays: Floats, pose: Pose, plane: Plane) -> tuple[Floats, Floats]:
    """Rays in the room's frame scaled to n · u = 1, (N, 3), and the depths at which they meet the plane, (N,)."""
    turned = pose.rotate(rays)
    facing = turned @ plane.normal
    return turned / facing[:, None], plane.offset_from(pose.translation) / facing
