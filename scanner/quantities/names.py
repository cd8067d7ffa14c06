"""What things are called on every page and in every table."""

FACE_NAMES = ("A", "B", "C")
