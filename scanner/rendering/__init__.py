"""Clouds, maps and photographs as pictures."""

from scanner.rendering.cloud_views import (
    Wireframe,
    frustum,
    frustum_lines,
    frustum_of_projector,
    render,
    rig_frusta,
    splatted_view,
    standard_views,
    view_along,
)
from scanner.rendering.colours import (
    BLACK,
    BLUE,
    BROWN,
    CIVIDIS,
    FACE_COLOURS,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SIGNED,
    SKY_BLUE,
    VERMILION,
    VIRIDIS,
    YELLOW,
    Colour,
    ColourScale,
    IndexedPicture,
    Pixels,
    as_pixels,
    between,
    css_colour,
    part_of,
    png_of,
    shaded,
)
from scanner.rendering.downsampling import (
    Map,
    averaged,
    cells_over,
    even_ticks,
    extent,
    labels_on_grid,
    one_in_cells,
    tick_text,
)
from scanner.rendering.photographs import LONGEST_SIDE, encode_jpeg, jpeg_uri, photograph, png_uri, reduced_size
from scanner.rendering.templates import page, script, script_hash
