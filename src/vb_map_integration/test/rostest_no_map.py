#!/usr/bin/env python3
"""map_integrator where nobody publishes a map."""

import unittest

import rostest
from vb_testing import assert_ends_with_one_line


class NoMapTest(unittest.TestCase):
    def test_it_gives_up_with_one_line(self):
        assert_ends_with_one_line("vb_map_integration", "map_integrator", [(["__name:=map_integrator"], "no_map")])


if __name__ == "__main__":
    rostest.rosrun("vb_map_integration", "no_map", NoMapTest)
