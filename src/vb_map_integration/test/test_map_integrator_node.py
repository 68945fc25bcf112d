"""Parts of the node map_integrator that need no ROS master; the other tests are in rostest_map_integrator.py."""

import rospy

from vb_map_integration.map_integrator_node import next_stamp


def test_each_change_in_a_tick_of_simulated_time_has_its_own_stamp():
    """Otherwise the third of three changes has the first one's stamp."""
    ticks, stamps = [1.0, 1.0, 1.0, 1.0, 2.0, 2.0], [rospy.Time(0)]
    for now in map(rospy.Time.from_sec, ticks):
        stamps.append(next_stamp(now, stamps[-1]))
        assert now <= stamps[-1] < now + rospy.Duration(0, 10_000)
    assert len(set(stamps)) == len(stamps)
    assert next_stamp(rospy.Time(0.5), stamps[-1]) == rospy.Time(0.5)  # the simulation was restarted
