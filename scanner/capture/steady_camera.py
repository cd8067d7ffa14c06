"""Settings that the camera changed by itself during a capture, as measured by the rig."""

from collections.abc import Iterator, Mapping

from calib.finding import Finding, FindingKind, Severity

# Per cent. Lamps flicker by a few, and sharpness differs by noise.
_EXPOSURE, _BALANCE, _FOCUS = 5.0, 3.0, 15.0

CAMERA_CHANGED = FindingKind(
    "camera-changed",
    "The camera changed its exposure, white balance or focus by itself during the capture.",
    "Turn that off in the camera, its driver or its app, and capture again.",
    ("after_white_percent", "exposure_percent", "white_balance_percent", "focus_percent"),
)


def findings_on_camera(metadata: Mapping[str, object]) -> Iterator[Finding]:
    """Yield warnings about what a recording, or the rig, states about the camera's steadiness."""
    change = metadata.get("camera_changed")
    if not isinstance(change, Mapping):
        return
    changed = {str(key): abs(value) for key, value in change.items() if isinstance(value, int | float)}
    if (adapted := changed.get("after_white_percent", 0.0)) > _EXPOSURE:
        yield Finding(
            CAMERA_CHANGED,
            Severity.WARNING,
            f"The camera adapts automatically: its picture kept changing by {adapted:.0f} % after white had come, so "
            "that exposure or white balance differs between patterns.",
            CAMERA_CHANGED.remedy,
            {"after_white_percent": float(adapted)},
        )
    for key, most, what in (
        ("exposure_percent", _EXPOSURE, "exposure, or the lamp's brightness,"),
        ("white_balance_percent", _BALANCE, "white balance"),
        ("focus_percent", _FOCUS, "focus"),
    ):
        if (percent := changed.get(key, 0.0)) > most:
            yield Finding(
                CAMERA_CHANGED,
                Severity.WARNING,
                f"The camera's {what} changed by {percent:.0f} % from the begin of the capture to its end.",
                CAMERA_CHANGED.remedy,
                {key: float(percent)},
            )
