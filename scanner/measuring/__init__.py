"""Spheres, faces and distances measured in the cloud of a result."""
