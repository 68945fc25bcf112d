"""check_navigation without the nodes that it asks."""
import pytest
import rospy

from vb_core.errors import CodedError
from vb_evaluation.live.navigation_check import NavigationCheck


def test_without_move_base_it_says_so_at_once(monkeypatch):
    waited = []

    def nobody(service, timeout):
        waited.append((service, timeout))
        raise rospy.ROSException("timeout exceeded")

    monkeypatch.setattr(rospy, "wait_for_service", nobody)
    check = NavigationCheck.__new__(NavigationCheck)
    check._move_base = "/robot1/move_base"
    with pytest.raises(CodedError, match="/robot1/move_base/make_plan") as caught:
        check.run()
    assert caught.value.code == "no_planner" and waited == [("/robot1/move_base/make_plan", 2.0)]
