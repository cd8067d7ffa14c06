"""Gray codes: the projector cell that each pixel is in."""

from scanner.decoding.codes.gray_code import CodeWords, Interval, cell_numbers, interval_of
