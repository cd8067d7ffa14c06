"""Live clouds: a short sequence repeated, decoded in parallel with the capture; kept clouds become stations."""
