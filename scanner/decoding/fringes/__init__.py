"""Phases: where in its cell a pixel is, and what bends a phase. Fringes decide where codes contradict each other."""
