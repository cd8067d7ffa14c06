"""The operator's page: live image, check, scan, result. One worker owns the rig; only `page` and its parts know viser."""
