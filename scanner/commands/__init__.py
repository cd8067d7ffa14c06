"""The commands: what can be typed is in arguments.py; what it does, in a module with `run(args)` each.

`scan` alone is the main job; the others are named by the first argument.
"""
