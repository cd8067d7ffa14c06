"""A check of a rig before a scan, in seconds: devices, light, lenses, and how well this view will calibrate."""
