"""What can be told about a rig before a scan, in seconds: devices, light, lenses, and what this view is worth."""
