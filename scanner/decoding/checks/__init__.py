"""Checks of frames, codes and coordinates for anomalies, which lead to a refusal or to a warning for the operator."""
