"""The operator's page: image, check, scan, result. One worker owns the rig; only the page and its parts know viser."""
