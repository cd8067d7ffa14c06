"""Adapts the period of pipelined acquisition to the jitter of the last frames."""

from collections import deque

from hw.timing.trigger_schedule import HEADWAY_S, SLACK_S, Pace

_LATELY = 16  # frames
_SINGLE = 1  # latest frames that are ignored: a single delay costs that frame, but does not slow down the others
_HEADROOM_S = 0.0008  # beyond the delays of the last frames
_MOST_SLACK_S = 0.02
_USUALLY = 0.75  # quantile of the camera's cycle; slack absorbs longer ones
_FEW, _MANY = 8, 3  # 3 misses within 8 frames are too many


class TriggerJitter:
    """Records for every frame the delay of its exposure, and the time until the camera was ready again."""

    def __init__(self, rhythm: Pace) -> None:
        self._rhythm = rhythm
        self._late_s = deque([SLACK_S - _HEADROOM_S] * (_SINGLE + 1), _LATELY)
        self._cycles_s = deque([rhythm.cycle_s], _LATELY)
        self._missed = deque[bool](maxlen=_FEW)

    @property
    def period_s(self) -> float:
        """Time between pictures: sufficient for all but the latest of the last exposures, and for the camera."""
        slack_s = min(_MOST_SLACK_S, sorted(self._late_s)[-1 - _SINGLE] + _HEADROOM_S)
        usual_s = sorted(self._cycles_s)[int(_USUALLY * len(self._cycles_s))]
        return max(self._rhythm.least_s + slack_s, usual_s + HEADWAY_S)

    def begun(self, late_s: float) -> None:
        """An exposure began, or would have begun, `late_s` after all light of its picture was expected."""
        self._late_s.append(max(0.0, late_s - self._rhythm.wait_s))

    def ready(self, cycle_s: float) -> None:
        """A frame arrived `cycle_s` after its trigger."""
        self._cycles_s.append(cycle_s + self._rhythm.wait_s)

    def holds(self) -> None:
        """A picture was captured."""
        self._missed.append(False)

    def fails(self) -> bool:
        """A picture was missed; returns whether too many were missed lately, and then restarts the count."""
        self._missed.append(True)
        many = self._missed.count(True) >= _MANY
        if many:
            self._missed.clear()
        return many
