"""What tests share: waiting for what has to come, the messages of a topic, commands, and nodes that are killed or do not start.

scripts/env.sh puts this folder on the path.
"""

from __future__ import annotations

import socket
import subprocess
import time
from xmlrpc.client import ServerProxy

import rosgraph
import rospy

from vb_evaluation.processes import spawn

_HEARD = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
TIMEOUT = 120.0  # [s] a busy computer takes ten times as long as an idle one; only a fault waits to the end


def wait_until(condition, what, timeout=TIMEOUT, clock=time.monotonic, sleep=time.sleep):
    """Waits until a condition gives something true, and returns that.

    Args:
        what: is waited for: words, or a function that finds them in the end.
        clock, sleep: those of another time than this computer's.

    Raises:
        AssertionError: says what was waited for in vain.
    """
    deadline = clock() + timeout
    while True:
        found = condition()
        if found:
            return found
        if clock() > deadline:
            raise AssertionError(f"waited {timeout:g} s in vain for: {what() if callable(what) else what}")
        sleep(0.02)


def run_command(*words, **options):
    """Runs a command to its end; what it said is in `stdout` of what is returned, errors among it.

    Args:
        options: as of subprocess.run.
    """
    return subprocess.run([str(word) for word in words], **{**_HEARD, **options})


def is_listening(port):
    """Returns whether something on this computer takes connections at a port."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def process_of(node):
    """Returns the id of a node's process; None while there is none."""
    try:
        return ServerProxy(rosgraph.Master("/test").lookupNode(node)).getPid("/test")[2]
    except (OSError, rosgraph.MasterException):
        return None


def write_program(path, text):
    """Writes a shell script that stands for a program, and returns its path as text."""
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


class Newest:
    """Keeps the messages of a topic. When it is made there is none, whatever else the node already answers.

    Args:
        keep: how many messages at the most.
    """

    def __init__(self, topic, message_type, keep=100_000):
        self.all, self.count = [], 0  # what was kept, how many ever came
        self.topic, self._keep = topic, keep
        self.subscriber = rospy.Subscriber(topic, message_type, self._take, queue_size=100, buff_size=2**22)

    def _take(self, message):
        self.all.append(message)
        del self.all[: -self._keep]
        self.count += 1  # last: a test that counts it can see it

    @property
    def message(self):
        """The newest message; waits for the first."""
        return wait_until(lambda: self.all and self.all[-1], f"a first message on {self.topic}")

    def wait(self, condition, what, timeout=TIMEOUT):
        """Waits until the newest message fulfils a condition, and returns that message."""
        return wait_until(
            lambda: next((message for message in self.all[-1:] if condition(message)), None),
            lambda: f"{what}; the newest on {self.topic} is {self.all[-1:]}",
            timeout,
        )

    def next(self, count=1):
        """Waits for the next message that comes, or for more of them, and returns the newest."""
        wanted = self.count + count
        wait_until(lambda: self.count >= wanted, f"{count} more messages on {self.topic}")
        return self.all[-1]


class Process:
    """A node in a process of its own that can be killed and started again; it ends with the test.

    Args:
        options: as of Popen.
    """

    def __init__(self, package, executable, *arguments, **options):
        self._command, self._options = ["rosrun", package, executable, *arguments], options
        self.start()

    def start(self):
        self.process = spawn(self._command, **self._options)  # rosrun becomes the node: the pid is the node's own

    def kill(self):
        """The hard way, as a crash does it."""
        self.process.kill()
        self.process.wait()

    def stop(self):
        """The polite way."""
        self.process.terminate()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.kill()


def assert_ends_with_one_line(package, executable, cases, **options):
    """Starts a node with arguments that it has to refuse: it ends with status 1 and says why, without a traceback.

    Args:
        cases: for each start its arguments and a word that it has to say.
        options: as of Popen.
    """
    started = [
        spawn(["rosrun", package, executable, f"__name:=bad_{executable}_{k}", *arguments], **_HEARD, **options)
        for k, (arguments, _word) in enumerate(cases)
    ]
    for process, (arguments, word) in zip(started, cases):
        output, _ = process.communicate(timeout=2 * TIMEOUT)
        assert process.returncode == 1, (arguments, process.returncode, output)
        fatal = [line for line in output.splitlines() if "FATAL" in line]
        assert len(fatal) <= 1 and "Traceback" not in output, (arguments, output)
        assert word in (fatal[0] if fatal else output), (arguments, word, output)
