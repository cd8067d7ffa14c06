"""Clouds, maps and photographs as pictures."""

from scanner.rendering.cloud_views import frustum, render, rig_frusta, standard_views
from scanner.rendering.colours import (
    BLUE,
    CIVIDIS,
    FACE_COLOURS,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    VIRIDIS,
    YELLOW,
    Colour,
    as_pixels,
    between,
    css_colour,
    part_of,
    shaded,
)
from scanner.rendering.downsampling import (
    Map,
    averaged,
    cells_over,
    extent,
    labels_on_grid,
    one_in_cells,
    places_within,
)
from scanner.rendering.photographs import LONGEST_SIDE, data_uri, photograph, reduced_size
from scanner.rendering.png import IndexedPicture, Pixels
