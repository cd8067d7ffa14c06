"""Motion during a capture: of the camera, of the projector, of something in the scene."""
