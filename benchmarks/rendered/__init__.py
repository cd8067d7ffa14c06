"""Rooms rendered by Mitsuba 3: the scene and its textures and intersections are Mitsuba's, light is traced here."""

import mitsuba as mi

mi.set_variant("llvm_ad_mono")  # before any of its classes is named
