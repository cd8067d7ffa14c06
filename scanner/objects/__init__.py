"""Things: stations of one rig → its poses relative to the thing, one surface, its volume."""
