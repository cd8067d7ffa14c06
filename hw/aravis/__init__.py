"""GenICam cameras (GigE Vision, USB3 Vision) through Aravis, which is imported when such a camera is asked for."""
