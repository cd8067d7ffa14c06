"""Photos of one corner by an ordinary camera: read, matched, calibrated and reconstructed."""

from scanner.photos.photo import Photo, read_photos
from scanner.photos.reconstruct import PhotoOptions, principal_point, reconstruct_photos, refuse_unsuitable
