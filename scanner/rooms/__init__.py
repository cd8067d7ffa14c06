"""Whole rooms: stations → the rig, where each stood, the walls; and everything that a person gets of it."""
