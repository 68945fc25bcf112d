"""Helpers for tests: waiting for conditions, messages of a topic, commands, and nodes that are killed or do not start.

scripts/env.sh puts this folder on the path.
"""

import socket
import subprocess
import time
from functools import partial
from pathlib import Path
from xmlrpc.client import ServerProxy

import rosgraph
import rospy

from vb_core.child_processes import spawn

TOP = Path(__file__).resolve().parents[2]  # the repository
_HEARD = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
TIMEOUT = 120.0  # [s] a busy computer takes ten times as long as an idle one; only a failure waits this long


def wait_until(condition, what, timeout=TIMEOUT, clock=time.monotonic, sleep=time.sleep):
    """Waits until a condition returns a true value, and returns that; otherwise the test fails and says what is missing.

    Args:
        what: what is waited for, in words, or a function that returns these words at the end.
        clock, sleep: functions of another time than this computer's.
    """
    deadline = clock() + timeout
    while True:
        result = condition()
        if result:
            return result
        if clock() > deadline:
            raise AssertionError(f"waited {timeout:g} s in vain for: {what() if callable(what) else what}")
        sleep(0.02)


def assert_fields(thing, **expected):
    """Checks several attributes of a message, or entries of a dictionary, at once; a failure shows what they are."""
    fields = {name: thing[name] if isinstance(thing, dict) else getattr(thing, name) for name in expected}
    assert fields == expected, f"{fields} instead of {expected}"


def run_command(*words, **options):
    """Runs a command to its end, as subprocess.run does; output and errors are both in `stdout` of the result."""
    return subprocess.run([str(word) for word in words], **{**_HEARD, **options})


def is_listening(port):
    """Returns whether something on this computer accepts connections at a port."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def process_of(node):
    """Returns a node's process id, or None while there is none."""
    try:
        return ServerProxy(rosgraph.Master("/test").lookupNode(node)).getPid("/test")[2]
    except (OSError, rosgraph.MasterException):
        return None


def write_program(path, text):
    """Writes a shell script that stands in for a program, and returns its path as text."""
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return str(path)


def listen(kinds):
    """Subscribes to topics, given with their message types; returns a dictionary that gets each one's newest message."""
    heard = {}
    for topic, kind in kinds.items():
        rospy.Subscriber(topic, kind, partial(heard.__setitem__, topic))
    return heard


class Newest:
    """Keeps the newest messages of a topic. At first there is none, even if the node already answers services."""

    def __init__(self, topic, message_type, keep=100_000):
        self.all, self.count = [], 0  # the messages kept, and how many ever came
        self.topic, self._keep = topic, keep
        self.subscriber = rospy.Subscriber(topic, message_type, self._take, queue_size=100, buff_size=2**22)

    def _take(self, message):
        self.all.append(message)
        del self.all[: -self._keep]
        self.count += 1  # last: once it is counted, a test can see it

    @property
    def message(self):
        """The newest message; waits for the first."""
        return wait_until(lambda: self.all and self.all[-1], f"a first message on {self.topic}")

    def wait(self, condition, what):
        """Waits until the newest message fulfils a condition, and returns that message."""
        return wait_until(
            lambda: next((message for message in self.all[-1:] if condition(message)), None),
            lambda: f"{what}; the newest on {self.topic} is {self.all[-1:]}",
        )

    def next(self, count=1):
        """Waits for this many further messages, and returns the newest."""
        wanted = self.count + count
        wait_until(lambda: self.count >= wanted, f"{count} more messages on {self.topic}")
        return self.all[-1]


class Process:
    """A node in a process of its own, with options of Popen, that can be killed and restarted; it ends with the test."""

    def __init__(self, package, executable, *arguments, **options):
        self._command, self._options = ["rosrun", package, executable, *arguments], options
        self.start()

    def start(self):
        self.process = spawn(self._command, **self._options)  # rosrun becomes the node: the pid is the node's

    def kill(self):
        """Kills the node, as a crash does."""
        self.process.kill()
        self.process.wait()

    def stop(self):
        """Terminates the node, and kills it if it does not end."""
        self.process.terminate()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.kill()


def assert_ends_with_one_line(package, executable, cases, **options):
    """Checks that a node with arguments that it has to refuse ends with status 1 and says why, without a traceback.

    `cases` are (arguments, a word that the node has to say) of each start; `options` are those of Popen.
    """
    started = [
        spawn(["rosrun", package, executable, f"__name:=bad_{executable}_{k}", *arguments], **_HEARD, **options)
        for k, (arguments, _word) in enumerate(cases)
    ]
    for process, (arguments, word) in zip(started, cases):
        output, _ = process.communicate(timeout=2 * TIMEOUT)
        assert process.returncode == 1, (arguments, process.returncode, output)
        fatal = [line for line in output.splitlines() if "FATAL" in line]
        assert len(fatal) <= 1, (arguments, output)
        assert "Traceback" not in output, (arguments, output)
        assert word in (fatal[0] if fatal else output), (arguments, word, output)
