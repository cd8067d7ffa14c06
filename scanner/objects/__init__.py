"""Things: stations of one rig → where it stood about the thing, one surface, its volume."""
