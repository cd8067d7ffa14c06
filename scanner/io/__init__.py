"""Files of each format, read and written whole or not at all. Knows nothing of scans."""

from scanner.io.atomic_file import (
    exchange,
    missing_folders,
    new_file,
    new_files,
    refuse_existing,
    remove_empty,
    require_space,
    sync,
    sync_open,
    sync_tree,
)
from scanner.io.calibration_file import parse_calibration, read_calibration, read_calibration_keys, write_calibration
from scanner.io.free_memory import free_bytes, require_memory, total_bytes
from scanner.io.given_file import (
    LONGEST_SIDE_PX,
    MOST_IMAGE_FILE_BYTES,
    MOST_PIXELS,
    copy_given,
    given_path,
    opened,
    read_bytes,
    read_whole,
    real_path,
    refuse_more_pixels,
)
from scanner.io.image_file import SUFFIXES, read_image
from scanner.io.image_size import UNREADABLE
from scanner.io.matches_file import (
    MATCHES_FILE,
    read_matches,
    read_only_axis,
    read_planes,
    refuse_one_axis,
    write_matches,
)
from scanner.io.ply import (
    CloudPoints,
    read_cloud,
    read_frame,
    write_merged_ply,
    write_ply,
    write_room_ply,
    write_scalar_ply,
)
from scanner.io.png import PngFile, PngRows, png_of, write_png
from scanner.io.room_file import (
    StoredDevice,
    StoredNetwork,
    StoredRoom,
    StoredStation,
    read_network,
    read_poses,
    read_room,
    write_poses,
    write_room,
)
from scanner.io.row_file import RowFile, by_rows, in_rows, scratch_rows, tiff_rows
from scanner.io.surface_file import StoredSurface, is_surface_file, read_surface
from scanner.io.validation import (
    LONGEST_M,
    SHORTEST_M,
    Entry,
    Flag,
    Metres,
    Number,
    Pair,
    Whole,
    known_keys,
    refuse_other_sizes,
    validate,
)
from scanner.io.yaml_text import block_yaml, flow_yaml, parse_mapping, parse_yaml, read_text, read_yaml
