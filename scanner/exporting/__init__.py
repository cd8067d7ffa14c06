"""Results in the formats of other programs, in the conventions of each.

A format is a row of `FORMATS` and a module with `export(request)`.
"""

from typing import TYPE_CHECKING

from calib.deferred_imports import defer_imports

if TYPE_CHECKING:
    from scanner.exporting.formats import DEFAULT_GAMMA as DEFAULT_GAMMA
    from scanner.exporting.formats import DEFAULT_POINTS as DEFAULT_POINTS
    from scanner.exporting.formats import FORMATS as FORMATS
    from scanner.exporting.formats import ExportRequest as ExportRequest
    from scanner.exporting.glb import Piece as Piece
    from scanner.exporting.glb import write_glb as write_glb
    from scanner.exporting.glb import write_pieces as write_pieces
    from scanner.exporting.result_mesh import mesh_in_axes as mesh_in_axes
    from scanner.exporting.result_mesh import mesh_of_result as mesh_of_result
    from scanner.exporting.triangles import Mesh as Mesh
    from scanner.exporting.triangles import mesh_of as mesh_of
    from scanner.exporting.triangles import open3d as open3d
    from scanner.exporting.triangles import reconstruct_surface as reconstruct_surface

# The command line asks for `FORMATS` alone.
__all__, __getattr__, __dir__ = defer_imports(
    __name__,
    {
        "formats": "DEFAULT_GAMMA DEFAULT_POINTS ExportRequest FORMATS",
        "glb": "Piece write_glb write_pieces",
        "result_mesh": "mesh_in_axes mesh_of_result",
        "triangles": "Mesh mesh_of open3d reconstruct_surface",
    },
)
