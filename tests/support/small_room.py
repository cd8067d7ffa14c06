"""A simulated room that is scanned in seconds."""

CONFIG = """
rig: {backend: simulated, furniture: false, interreflection: false, ambient: 0}
camera: {width: 306, height: 256, principal_point: {known: [157.04, 131.79]}}
projector: {width: 214, height: 120}
sequence: {preset: quick}
corner: {squareness_deg: 0}
"""
