"""Projection mapping: every projector as a camera beside the room's mesh, and maps for players from its own eye."""

from scanner.exporting.mapping.write import export
