"""CAD models as STEP files (ISO 10303-21): boxes with plane faces, for readers to be compared with."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from calib.numerics import Floats

_FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
_HEAD = """ISO-10303-21;
HEADER;
FILE_DESCRIPTION((''),'2;1');
FILE_NAME('','',(''),(''),'','','');
FILE_SCHEMA(('AUTOMOTIVE_DESIGN'));
ENDSEC;
DATA;
"""


class _Lines:
    """Entities with their numbers."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def add(self, entity: str) -> str:
        self.lines.append(f"#{len(self.lines) + 1}={entity};")
        return f"#{len(self.lines)}"

    def add_vector(self, kind: str, vector: Floats) -> str:
        return self.add(f"{kind}('',({','.join(f'{value:.12E}' for value in vector)}))")


def step_of_box(size: Floats | Sequence[float], corner: Floats | Sequence[float], *, in_metres: bool = False) -> str:
    """A box of a size (3,) with its least corner (3,), in millimetres unless `in_metres`."""
    file = _Lines()
    corners = np.array(list(product((0.0, 1.0), repeat=3))) * np.asarray(size) + np.asarray(corner)
    points = [file.add_vector("CARTESIAN_POINT", place) for place in corners]
    faces = []
    for face in _FACES:
        along, across = corners[face[1]] - corners[face[0]], corners[face[2]] - corners[face[1]]
        normal = np.cross(along, across)
        axes = [file.add_vector("DIRECTION", way / np.linalg.norm(way)) for way in (normal, along)]
        place = file.add(f"AXIS2_PLACEMENT_3D('',{points[face[0]]},{axes[0]},{axes[1]})")
        loop = file.add(f"POLY_LOOP('',({','.join(points[k] for k in face)}))")
        bound, plane = file.add(f"FACE_OUTER_BOUND('',{loop},.T.)"), file.add(f"PLANE('',{place})")
        faces.append(file.add(f"FACE_SURFACE('',({bound}),{plane},.T.)"))
    shell = file.add(f"CLOSED_SHELL('',({','.join(faces)}))")
    solid = file.add(f"FACETED_BREP('',{shell})")
    context = file.add("APPLICATION_CONTEXT('automotive design')")
    of_product = file.add(f"PRODUCT_CONTEXT('',{context},'mechanical')")
    part = file.add(f"PRODUCT('box','box','',({of_product}))")
    formation = file.add(f"PRODUCT_DEFINITION_FORMATION('','',{part})")
    of_design = file.add(f"PRODUCT_DEFINITION_CONTEXT('part definition',{context},'design')")
    definition = file.add(f"PRODUCT_DEFINITION('','',{formation},{of_design})")
    shape = file.add(f"PRODUCT_DEFINITION_SHAPE('','',{definition})")
    unit = file.add(f"(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT({'$' if in_metres else '.MILLI.'},.METRE.))")
    angle = file.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
    solid_angle = file.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
    space = file.add(
        "(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNIT_ASSIGNED_CONTEXT("
        f"({unit},{angle},{solid_angle}))REPRESENTATION_CONTEXT('',''))"
    )
    model = file.add(f"FACETED_BREP_SHAPE_REPRESENTATION('',({solid}),{space})")
    file.add(f"SHAPE_DEFINITION_REPRESENTATION({shape},{model})")
    return _HEAD + "\n".join(file.lines) + "\nENDSEC;\nEND-ISO-10303-21;\n"
