"""Photos of one corner by an ordinary camera: read, matched, calibrated and reconstructed."""
