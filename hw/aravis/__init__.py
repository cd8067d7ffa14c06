"""GenICam cameras (GigE Vision, USB3 Vision) through Aravis, which is imported only when needed."""

from hw.aravis.settings import AravisRigSettings
