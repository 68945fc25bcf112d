"""How long places have been lit: what shines at one place for long, in whatever rhythm, is a lamp and no pointer."""

from __future__ import annotations

from typing import List, Optional, Tuple

import cv2
import numpy as np

PLACE_PX = 12.0  # light so near to a place [px] is at that place: noise alone may move a spot so far
_BLINK = 1.5  # [s] light that is away for no longer is taken to be there all the time
_MEMORY = 10.0  # a place is remembered for so many times as long as it was lit


class LitPlaces:
    """The places of one camera's image where there was light, each with how long [s] it was lit.

    Nothing here knows tracks: a blinking light, one that others cross, one that is lost and found again are all the same
    to it. A stroke lights each of its places for a moment, and they are soon forgotten.
    """

    def __init__(self) -> None:
        self._places = np.zeros((0, 4))  # u, v [px], lit for, last lit at [s]

    def begin(self, stamp: float, motion: Optional[np.ndarray]) -> None:
        """Begins an image.

        Args:
            stamp: [s] of the image.
            motion: (3, 3) from the last image's pixels to this one's; None: the camera was stationary.
        """
        known = self._places[:, 3] + _BLINK + _MEMORY * self._places[:, 2] >= stamp
        if not known.all():
            self._places = self._places[known]
        if motion is not None and len(self._places):
            self._places[:, :2] = cv2.perspectiveTransform(self._places[None, :, :2], motion)[0]

    def light(self, places: List[Tuple[float, float]], stamp: float) -> List[float]:
        """Records light at places (u, v) [px]; returns for how long [s] each has been lit by now."""
        result = []
        for u, v in places:
            index = self._nearest(u, v)
            if index is None:
                index = len(self._places)
                self._places = np.vstack([self._places, (u, v, 0.0, stamp)])
            place = self._places[index]
            if stamp - place[3] <= _BLINK:
                place[2] += stamp - place[3]
            place[3] = stamp
            result.append(float(place[2]))
        return result

    def _nearest(self, u: float, v: float) -> Optional[int]:
        if not len(self._places):
            return None
        away = np.hypot(self._places[:, 0] - u, self._places[:, 1] - v)
        index = int(np.argmin(away))
        return index if away[index] <= PLACE_PX else None
