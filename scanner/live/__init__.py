"""Live clouds from a short sequence, decoded during the capture; kept clouds become stations."""
