"""Examples for a classifier of one's own from a recording with clicks."""

import numpy as np
import rosbag
import rospy
from geometry_msgs.msg import Point

from scenes import GREEN, Scene
from vb_core.ros.images import message_from_image
from bench.detection.fitting import load_examples, save_examples

from bench.detection.training import from_recording


def test_a_recording_and_clicks_make_examples(tmp_path):
    scene, places, path = Scene(320, 240), [(60.0, 80.0), (200.0, 150.0), (260.0, 60.0)], str(tmp_path / "hall.bag")
    with rosbag.Bag(path, "w") as bag:
        for i in range(20 + 12 * len(places)):
            stamp, spots = rospy.Time.from_sec(100.0 + 0.2 * i), []
            floor = scene.floor.copy()
            if i < 20:  # until 3 s before the first click somebody's sheet of paper is moved about
                floor[100:160, 10 * i : 10 * i + 60] = 250.0
            else:
                spots = [places[(i - 20) // 12]]
            image = scene.render(spots, color=GREEN, floor=floor)
            bag.write("/hall/image_raw", message_from_image(image, "bgr8", stamp, "hall"), stamp)
            if spots and (i - 20) % 12 == 6:
                bag.write("/hall/image_raw_mouse_left", Point(round(spots[0][0]), round(spots[0][1]), 0), stamp)
    examples = from_recording(path, "/hall/image_raw")
    # half a second about each click counts
    assert examples.truth.sum() >= 3 * len(places)
    assert set(examples.groups) == {"recording: hall.bag"} and examples.values.shape == (
        len(examples.truth),
        len(examples.names),
    )
    save_examples(examples, tmp_path / "kept.npz")
    kept = load_examples([tmp_path / "kept.npz"])
    assert np.array_equal(kept.truth, examples.truth) and kept.names == examples.names
