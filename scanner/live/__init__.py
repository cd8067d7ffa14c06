"""Clouds while one looks: a short sequence over and over, decoded beside the camera; what is kept becomes stations."""
