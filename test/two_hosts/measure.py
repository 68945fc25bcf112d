#!/usr/bin/env python3
"""What crosses the network between a camera's computer and this one: spots alone, and then one camera's images.

    measure.py INTERFACE [--seconds 10]

Exit status 0 if spots arrived, reached the fusion, and with them less than a hundredth of the images' bytes crossed.
"""
import argparse
import sys
import threading
from pathlib import Path

import numpy as np
import rospy
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image

from vb_core import names
from vb_msgs.msg import BorderProgress, LaserSpot
from vb_msgs.srv import Command, CommandRequest

PATIENCE = 90.0


class Watch:
    """Counts what arrives on topics, and the bytes on a network interface."""

    def __init__(self, interface):
        self._statistics = Path("/sys/class/net") / interface / "statistics"
        self.changed = threading.Condition()
        self.spots, self.images, self.progress, self.clock = [], 0, None, ""
        rospy.Subscriber(names.SPOTS, LaserSpot, self._store, callback_args=self._on_spot, queue_size=100)
        rospy.Subscriber(names.PROGRESS, BorderProgress, self._store, callback_args=self._on_progress)
        rospy.Subscriber("/diagnostics", DiagnosticArray, self._store, callback_args=self._on_diagnostics)

    def _store(self, message, handle):
        with self.changed:
            handle(message)
            self.changed.notify_all()

    def _on_spot(self, message):
        self.spots.append(1e3 * (rospy.Time.now() - message.header.stamp).to_sec())

    def _on_progress(self, message):
        self.progress = message

    def _on_diagnostics(self, message):
        for status in message.status:
            if "clock of" in status.name:
                self.clock = status.message

    def count_images(self):
        def count(_message):
            self.images += 1

        return rospy.Subscriber(
            "/green/image_raw", Image, self._store, callback_args=count, queue_size=1, buff_size=2**24
        )

    def wait(self, condition, what):
        with self.changed:
            if not self.changed.wait_for(condition, PATIENCE):
                sys.exit(f"waited in vain for {what}")

    def rate(self, seconds):
        """(received, sent) [kB/s] over so many seconds."""
        before = self._bytes()
        rospy.rostime.wallsleep(seconds)
        return tuple((after - start) / seconds / 1e3 for start, after in zip(before, self._bytes()))

    def _bytes(self):
        return [int((self._statistics / name).read_text()) for name in ("rx_bytes", "tx_bytes")]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("interface")
    parser.add_argument("--seconds", type=float, default=10.0)
    arguments = parser.parse_args()
    rospy.init_node("measure")
    watch = Watch(arguments.interface)
    watch.wait(lambda: watch.spots, "a spot from the other computer")
    rospy.wait_for_service(names.COMMAND, timeout=PATIENCE)
    answer = rospy.ServiceProxy(names.COMMAND, Command)(CommandRequest(command="define_border", source="wizard"))
    if not answer.success:
        sys.exit(f"define_border: {answer.message}")
    watch.wait(lambda: watch.progress is not None and watch.progress.border_spots > 5, "spots in the fusion")
    watch.wait(lambda: watch.clock and "answer" not in watch.clock, "the comparison of the clocks")
    with watch.changed:
        watch.spots.clear()
    received, sent = watch.rate(arguments.seconds)
    with watch.changed:
        latencies = np.array(watch.spots)
    subscriber = watch.count_images()
    watch.wait(lambda: watch.images > 3, "images")
    watch.images = 0
    with_images, _ = watch.rate(arguments.seconds / 2)
    images = watch.images / (arguments.seconds / 2)
    subscriber.unregister()
    print(f"""
clocks:              {watch.clock}
spots only:          {received:8.1f} kB/s in, {sent:.1f} kB/s out, {len(latencies) / arguments.seconds:.1f} spots/s,
                     from image stamp to here {np.median(latencies):.0f} ms, p95 {np.percentile(latencies, 95):.0f} ms
spots in the fusion: {watch.progress.border_spots}
with one camera's images: {with_images:8.0f} kB/s in, {images:.1f} images/s received
""")
    return 0 if received < with_images / 100.0 else 1


if __name__ == "__main__":
    sys.exit(main())
