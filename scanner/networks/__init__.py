"""Networks: captures of several cameras and projectors → every device, one cloud, and whether the cameras agree."""
