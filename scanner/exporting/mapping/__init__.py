"""Projection mapping: every projector as a camera of the room's mesh, and maps for players from its viewpoint."""

from scanner.exporting.mapping.write import export
