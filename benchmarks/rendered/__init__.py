"""Rooms rendered with Mitsuba 3: it has scene, textures and intersections; light is traced here."""

import mitsuba as mi

mi.set_variant("llvm_ad_mono")  # before any of its classes is named
