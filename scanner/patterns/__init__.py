"""Patterns as values, the sequences made of them, and how they are drawn."""

from scanner.patterns.pattern import (
    PRESETS,
    Axis,
    Black,
    Code,
    Gray,
    Pattern,
    Phase,
    Preset,
    PresetName,
    White,
    Xor,
    count_bits,
    draw,
    gray_sequence,
    in_square_pixels,
    phase_sequence,
    sequence_for,
    xor_sequence,
)
from scanner.patterns.projector_response import ProjectorResponse
from scanner.patterns.redundancy import level_groups, unpaired_bits
from scanner.patterns.sequence_file import (
    FORMAT,
    PIXEL_ASPECT_KEY,
    SEQUENCE_FILE,
    PatternEntry,
    aspect_to_dict,
    frame_line,
    pattern_to_dict,
    size_to_dict,
    write_sequence,
)
