"""The delay of a camera's images is measured from a window that blinks, against the true delay."""

import math

import numpy as np
import pytest

from refusals import refused
from vb_laser_detect.camera.delay import brightness, measure_delay


def film_blinking_window(delay, rate, rng, contrast=60.0):
    """Returns when a window was switched [s], and stamp [s] and brightness of each image of it, `delay` [s] late."""
    switch_times = np.cumsum(rng.uniform(0.25, 0.65, 40)) + 100.0
    images = []
    for stamp in np.arange(99.0, switch_times[-1] + 3.0, 1.0 / rate) + rng.normal(0, 0.002):
        exposure = stamp - delay + np.linspace(-0.25, 0.25, 9) / rate
        share_lit = np.mean(np.searchsorted(switch_times, exposure) % 2)
        image = np.full((180, 320), 70.0)
        image[40:73, 200:233] += contrast * share_lit
        image[100:160, 20:120] += 15.0 * math.sin(0.9 * stamp)
        image = np.clip(image + rng.normal(0, 2.0, image.shape), 0, 255).astype(np.uint8)
        images.append((stamp, brightness(image)))
    return switch_times, images


@pytest.mark.parametrize("delay, rate", [(0.0, 30.0), (0.045, 25.0), (0.3, 10.0), (1.6, 25.0)])
def test_the_delay_is_measured(delay, rate):
    rng = np.random.default_rng(int(1000 * delay + rate))
    measured, uncertainty = measure_delay(*film_blinking_window(delay, rate, rng))
    assert abs(measured - delay) < max(0.008, uncertainty)
    assert uncertainty < 0.05


def test_images_that_do_not_follow_the_light_say_nothing():
    switch_times, images = film_blinking_window(0.1, 25.0, np.random.default_rng(5), contrast=0.0)
    with refused("no_blinking"):
        measure_delay(switch_times, images)
