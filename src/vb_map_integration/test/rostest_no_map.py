#!/usr/bin/env python3
"""map_integrator where nobody publishes a map."""

import subprocess
import unittest

import rostest


class NoMapTest(unittest.TestCase):
    def test_it_gives_up_with_one_line_that_names_the_topic(self):
        done = subprocess.run(
            ["rosrun", "vb_map_integration", "map_integrator"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            stdin=subprocess.DEVNULL,
            universal_newlines=True,
            timeout=240,
        )
        self.assertEqual(done.returncode, 1, done.stderr)
        fatal = [line for line in done.stderr.splitlines() if "FATAL" in line]
        self.assertEqual(len(fatal), 1, done.stderr)
        self.assertIn("/map", fatal[0])
        self.assertNotIn("Traceback", done.stderr)


if __name__ == "__main__":
    rostest.rosrun("vb_map_integration", "no_map", NoMapTest)
