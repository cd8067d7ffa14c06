"""Gray codes: the projector cell that each pixel is in, checks of its bits, and stripe edges within the cell."""

from scanner.decoding.codes.code_checks import check_codes
from scanner.decoding.codes.edge_interpolation import BEND_OF_SLOPE, CELLS_PER_PIXEL, StripeLevels, interpolate
from scanner.decoding.codes.gray_code import CodeWords, Interval, cell_numbers, interval_of
