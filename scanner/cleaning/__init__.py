"""What named steps leave of a result's cloud. Everything that exports or shows a cloud reads it here."""

from scanner.cleaning.cleaned_result import CleanedCloud, CleanedResult, read_cleaned
from scanner.cleaning.clouds import OF_MESH, axes_of, inside_box, length_of, spacing_of
