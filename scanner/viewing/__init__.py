"""A finished result in 3-D, in the browser. Only `scene`, `panel` and `server` know viser; the rest is arrays and text."""
