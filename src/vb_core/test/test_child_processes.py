import os
import socket
import signal
import subprocess
import sys
import uuid

import psutil

from vb_core.child_processes import ChildProcess, free_port, spawn
from vb_testing import wait_until

# ignores SIGINT, as a hanging node does
HANGING = """
import signal
import subprocess

signal.signal(signal.SIGINT, signal.SIG_IGN)
started = subprocess.Popen(["sleep", "600"])
print("up", flush=True)
started.wait()
"""


def test_a_child_and_all_it_started_end(tmp_path):
    mark = uuid.uuid4().hex
    child = ChildProcess(["env", f"MARK={mark}", sys.executable, "-c", HANGING], tmp_path / "log" / "child.txt")
    wait_until(lambda: child.tail() == "up", "the child")
    assert len(commands_with(mark)) == 2
    child.stop(timeout=0.2)
    assert not child.running
    wait_until(lambda: not commands_with(mark), "all that it started ends")


def test_free_port_is_the_wanted_one_while_that_is_free():
    with socket.socket() as first:
        first.bind(("127.0.0.1", free_port()))
        first.listen()
        used_port = first.getsockname()[1]
        free = free_port(used_port)
        assert free != used_port
        with socket.socket() as second:
            second.bind(("127.0.0.1", free))
        assert free_port(free) == free


LAB = """
import sys
import time
from pathlib import Path
from vb_core.child_processes import ChildProcess, free_port

folder = Path(sys.argv[1])
ChildProcess(["roslaunch", "-p", str(free_port()), str(folder / "node.launch")], folder / "launch.txt")
print("up", flush=True)
time.sleep(3600)
"""


def commands_with(mark):
    """Returns the command lines of the processes with this value in their environment; a zombie has none."""
    infos = [process.info for process in psutil.process_iter(["environ", "cmdline"])]
    return [info["cmdline"] for info in infos if info["cmdline"] and mark in (info["environ"] or {}).values()]


def test_a_script_that_is_ended_leaves_nothing_behind(tmp_path):
    mark = uuid.uuid4().hex
    (tmp_path / "node.launch").write_text("<launch/>")  # a master and rosout are enough
    environment = {**os.environ, "MARK": mark, "ROS_LOG_DIR": str(tmp_path)}
    script = spawn([sys.executable, "-c", LAB, str(tmp_path)], stdout=subprocess.PIPE, env=environment)
    assert script.stdout.readline() == b"up\n"
    wait_until(lambda: "rosout" in str(commands_with(mark)), "roslaunch starts its nodes")
    script.send_signal(signal.SIGTERM)
    script.communicate(timeout=120)
    assert script.returncode == -signal.SIGTERM
    wait_until(lambda: not commands_with(mark), "all that it started ends")
