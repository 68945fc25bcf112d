#!/usr/bin/env python3
"""What crosses the network between a camera's computer and this one: spots alone, and then one camera's images.

    measure.py INTERFACE [--spots 200] [--images 20]

Waits for each step of the stack to be there, then for so many spots and so many images, however long they take. Exit
status 0 if spots arrived and reached the fusion, and one took less than a hundredth of an image's bytes to cross.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import rospy
from sensor_msgs.msg import Image

from vb_testing import TIMEOUT, wait_until
from vb_core import names
from vb_msgs.msg import BorderProgress, LaserSpot
from vb_msgs.srv import Command, CommandRequest


class Watch:
    """Counts what arrives on topics, and the bytes on a network interface."""

    def __init__(self, interface):
        self._statistics = Path("/sys/class/net") / interface / "statistics"
        self.spots, self.images, self.progress = [], 0, None
        rospy.Subscriber(names.SPOTS, LaserSpot, self._on_spot, queue_size=100)
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._on_progress)

    def _on_spot(self, message):
        self.spots.append(1e3 * (rospy.Time.now() - message.header.stamp).to_sec())

    def _on_progress(self, message):
        self.progress = message

    def _on_image(self, _message):
        self.images += 1

    def count_images(self):
        return rospy.Subscriber("/green/image_raw", Image, self._on_image, queue_size=1, buff_size=2**24)

    def crossing(self, condition, what):
        """Measures (received, sent) [bytes], and how long it took [s], until something has come."""
        before, began = self._bytes(), time.monotonic()
        wait_until(condition, what)
        return tuple(after - start for start, after in zip(before, self._bytes())), time.monotonic() - began

    def _bytes(self):
        return [int((self._statistics / name).read_text()) for name in ("rx_bytes", "tx_bytes")]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("interface")
    parser.add_argument("--spots", type=int, default=200)
    parser.add_argument("--images", type=int, default=20)
    arguments = parser.parse_args()
    rospy.init_node("measure")
    watch = Watch(arguments.interface)
    wait_until(lambda: watch.spots, "a spot from the other computer")
    define_border()
    wait_until(lambda: watch.progress is not None and watch.progress.border_spots > 5, "spots in the fusion")
    watch.spots.clear()
    (received, sent), took = watch.crossing(lambda: len(watch.spots) >= arguments.spots, f"{arguments.spots} spots")
    latencies = np.array(watch.spots)
    subscriber = watch.count_images()
    wait_until(lambda: watch.images > 3, "images")
    watch.images = 0
    enough = f"{arguments.images} images"
    (with_images, _), images_took = watch.crossing(lambda: watch.images >= arguments.images, enough)
    images = watch.images
    subscriber.unregister()
    per_spot, per_image = received / len(latencies), with_images / images
    median, p95 = np.percentile(latencies, (50, 95))
    print(f"""
spots only:          {received / took / 1e3:8.1f} kB/s in, {sent / took / 1e3:.1f} kB/s out,
                     {len(latencies) / took:.1f} spots/s, from image stamp to here {median:.0f} ms, p95 {p95:.0f} ms
spots in the fusion: {watch.progress.border_spots}
with one camera's images: {with_images / images_took / 1e3:8.0f} kB/s in, {images / images_took:.1f} images/s received
for each spot {per_spot / 1e3:.2f} kB crossed, for each image {per_image / 1e3:.0f} kB
""")
    return 0 if per_spot < per_image / 100.0 else 1


def define_border():
    """Begins a border; a manager that has just started may not answer yet."""
    rospy.wait_for_service(names.COMMAND, timeout=TIMEOUT)
    command, answers = rospy.ServiceProxy(names.COMMAND, Command), []

    def begun():
        try:
            answers.append(command(CommandRequest(command="define_border", source="wizard")))
        except rospy.ServiceException as error:
            answers.append(error)
        return getattr(answers[-1], "success", False)

    wait_until(begun, lambda: f"define_border: {answers[-1]}")


if __name__ == "__main__":
    sys.exit(main())
