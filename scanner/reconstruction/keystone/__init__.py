"""Pictures that a projector corrects for keystone: measured by the beat of the finest stripes, and taken back."""

from scanner.reconstruction.keystone.measure import on_panel
