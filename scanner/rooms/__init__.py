"""Whole rooms: stations → the rig, its poses, the walls; and the files for people."""
