"""Fringes: phase unwrapping, systematic phase errors, and contradictions between codes that fringes resolve."""
