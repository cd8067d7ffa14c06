"""The formats and their file names. Their modules are loaded on demand."""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from scanner.errors import InputError

DEFAULT_POINTS = 20_000
DEFAULT_GAMMA = 2.2


@dataclass(frozen=True)
class ExportRequest:
    """An export and its destination."""

    result: Path
    """A result folder."""
    out: Path
    overwrite: bool = False
    capture: int | None = None
    """The number of one capture or station, from 1; None: all of them."""
    most_points: int = DEFAULT_POINTS
    """Of formats that hold a subset of the points."""
    eye: tuple[float, float, float] | None = None
    """From where a mapping's content is seen, in metres in the axes of its GLB; None: straight on."""
    gamma: float = DEFAULT_GAMMA
    """Of a mapping's blend maps."""


@dataclass(frozen=True)
class Format:
    """A target: `suffixes` its files may have (none: a folder), the default first, and `ending`, for a default name.

    `module` of this package has `export(request)`; `opened_by`: which program reads it, as a sentence.
    """

    about: str
    ending: str
    suffixes: tuple[str, ...]
    module: str
    opened_by: str

    def check_name(self, out: Path) -> None:
        """Raise InputError if a file of this format is not called like that."""
        if self.suffixes and out.suffix.lower() not in self.suffixes:
            raise InputError(f"{out}: expected a name that ends in {' or '.join(self.suffixes)}")

    def write(self, request: ExportRequest) -> list[str]:
        """Write the export; returns sentences about it. Raises InputError and OSError."""
        sentences: list[str] = import_module(f"scanner.exporting.{self.module}").export(request)
        return sentences


FORMATS: dict[str, Format] = {
    "opencv": Format(
        "calibration as OpenCV's FileStorage", "-opencv.yaml", (".yaml", ".yml"), "opencv", "cv2.FileStorage reads it."
    ),
    "colmap": Format(
        "text model with some of the points", "-colmap", (), "colmap", "COLMAP reads it: File, Import model."
    ),
    "mrcal": Format(
        "calibration as mrcal's camera models",
        "-mrcal",
        (),
        "mrcal",
        "mrcal reads camera.cameramodel and the projector's.",
    ),
    "ply": Format("the cloud", "-cloud.ply", (".ply",), "cloud", "MeshLab, CloudCompare and Open3D read it."),
    "pcd": Format(
        "the cloud for the Point Cloud Library and ROS", "-cloud.pcd", (".pcd",), "cloud", "PCL and ROS read it."
    ),
    "e57": Format(
        "the cloud, upright and in metres (needs pye57)",
        ".e57",
        (".e57",),
        "e57",
        "CloudCompare and CAD programs read it.",
    ),
    "las": Format(
        "the cloud, z up and in metres, by the name's ending LAS or LAZ (needs laspy)",
        ".laz",
        (".laz", ".las"),
        "las",
        "CloudCompare, QGIS and PDAL read it.",
    ),
    "stl": Format(
        "triangles in millimetres, z up, for printing",
        ".stl",
        (".stl",),
        "printing",
        "Slicers and CAD programs read it.",
    ),
    "3mf": Format("the same as 3MF, which states its unit", ".3mf", (".3mf",), "printing", "Slicers read it."),
    "mesh": Format(
        "triangles, by the name's ending GLB, PLY or OBJ",
        "-mesh.glb",
        (".glb", ".ply", ".obj"),
        "mesh",
        "Blender and MeshLab read it.",
    ),
    "usd": Format(
        "triangles as USD, y up and in metres", ".usda", (".usda",), "usd", "Blender, Houdini and Omniverse read it."
    ),
    "mapping": Format(
        "projectors as cameras, and maps for players: warp, blend, depth, position",
        "-mapping",
        (),
        "mapping",
        "Blender reads mapping.glb, players the maps of each projector; mapping.yaml says how.",
    ),
}
