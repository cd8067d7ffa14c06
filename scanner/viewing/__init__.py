"""A finished result in 3-D, in the browser. Only scene, panel, server and view use viser."""
