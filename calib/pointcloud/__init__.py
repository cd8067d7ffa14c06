"""Point clouds, organised on the camera's pixel grid or unordered: surfaces, planes, spheres, registration."""

from calib.pointcloud.corner_registration import CornerView, Order, cells_of, find_order
from calib.pointcloud.image_mesh import SeenPoints, image_triangles
from calib.pointcloud.merged_cloud import MergedCloud, merged
from calib.pointcloud.organised_cloud import Cloud, CloudStatistics, build_cloud, colours_of, scattered_surface, surface
from calib.pointcloud.pixel_grid import NONE, density, grid_step, index_grid, without_gaps
from calib.pointcloud.plane_fit import FittedPlane, dihedral_angle_rad, dihedral_gradients, fit_plane
from calib.pointcloud.sphere_fit import OrganisedPoints, Sphere, find_sphere, fit_sphere, image_radius_px
from calib.pointcloud.triangulation_errors import by_projector_px, point_covariances
