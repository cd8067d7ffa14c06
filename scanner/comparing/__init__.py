"""Comparison of two calibrations of one rig: where they differ, and whether their sigmas allow it."""

from scanner.comparing.comparison import CalibrationComparison, Sheet, compare_files
from scanner.comparing.page import COMPARE_FILE, COMPARE_PAGE, write_compare, write_compare_page
from scanner.comparing.summary import comparison_verdict, headings, rows, table
