"""How much time there is between pictures in pipelined acquisition: what the last frames needed."""

from collections import deque

from hw.timing.trigger_schedule import HEADWAY_S, SLACK_S, Pace

_LATELY = 16  # frames
_SINGLE = 1  # of these: what holds up one costs that frame, and does not slow down all that follow
_HEADROOM_S = 0.0008  # beyond what was needed
_MOST_SLACK_S = 0.02
_USUALLY = 0.75  # of the frames: what the rest take longer, a picture's slack makes up for
_FEW, _MANY = 8, 3  # so many misses in so few frames: pictures are not caught


class TriggerJitter:
    """Learns from every frame how late its exposure began, and how long it was until the camera was ready again."""

    def __init__(self, rhythm: Pace) -> None:
        self._rhythm = rhythm
        self._late_s = deque([SLACK_S - _HEADROOM_S] * (_SINGLE + 1), _LATELY)
        self._cycles_s = deque([rhythm.cycle_s], _LATELY)
        self._missed = deque[bool](maxlen=_FEW)

    @property
    def period_s(self) -> float:
        """From one picture to the next: enough for all but the latest of the last exposures, and for the camera."""
        slack_s = min(_MOST_SLACK_S, sorted(self._late_s)[-1 - _SINGLE] + _HEADROOM_S)
        usual_s = sorted(self._cycles_s)[int(_USUALLY * len(self._cycles_s))]
        return max(self._rhythm.least_s + slack_s, usual_s + HEADWAY_S)

    def begun(self, late_s: float) -> None:
        """An exposure began, or would have begun, so long after all light of its picture was to be there."""
        self._late_s.append(max(0.0, late_s - self._rhythm.wait_s))

    def ready(self, cycle_s: float) -> None:
        """So long after its exposure was triggered a frame was there."""
        self._cycles_s.append(cycle_s + self._rhythm.wait_s)

    def holds(self) -> None:
        """A picture was caught."""
        self._missed.append(False)

    def fails(self) -> bool:
        """A picture was missed; whether those are many by now, which then begin to be counted anew."""
        self._missed.append(True)
        many = self._missed.count(True) >= _MANY
        if many:
            self._missed.clear()
        return many
