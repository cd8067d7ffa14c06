"""Pictures that a projector corrects for keystone: measured by the beat of the finest stripes, and taken back."""

from scanner.reconstruction.keystone.panel_pixels import on_panel
