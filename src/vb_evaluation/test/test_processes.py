import re
import sys

from vb_evaluation.processes import Child, free_port, start_screen


def test_a_child_and_all_it_started_end(tmp_path):
    # the child ignores the polite request, as a hanging node does
    script = "import signal, time\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\nprint('up', flush=True)\ntime.sleep(600)"
    child = Child([sys.executable, "-c", script], tmp_path / "log" / "child.txt")
    assert child.running
    child.stop(patience_s=0.2)
    assert not child.running


def test_what_a_child_wrote_can_be_told(tmp_path):
    child = Child([sys.executable, "-c", "print('one'); print('two')"], tmp_path / "child.txt")
    child._process.wait(30)
    assert child.tail(1) == "two" and not child.running


def test_a_free_port_is_a_port():
    assert 1024 < free_port() < 65536


def test_two_screens_are_two_displays(tmp_path):
    screens = [start_screen(tmp_path / f"{name}.txt", 64, 48) for name in "ab"]
    try:
        assert all(screen.running and re.fullmatch(r":\d+", display) for screen, display in screens)
        assert screens[0][1] != screens[1][1]
    finally:
        for screen, _ in screens:
            screen.stop()
