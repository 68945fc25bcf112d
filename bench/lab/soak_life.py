"""Faults in a soak test, and how people are told of them; for soak.py."""

from __future__ import annotations

import os
import signal
import time
import xmlrpc.client
from typing import Any, Optional

import numpy as np
import rosgraph
import rospy

from bench.lab.soak_stack import CAMERAS, NOTICED_S, RESOLUTION, TIMEOUT, Broken, Stack
from vb_core import names
from vb_core.grid_map import GridMap
from vb_core.ros.messages import message_from_grid
from vb_msgs.srv import Command, ConfirmMap, ConfirmMapRequest


class Trouble(Stack):
    """Faults, and how people are told of them."""

    def call(self, service: str, kind: Any, **fields: Any) -> Any:
        """Calls a service; while its node comes back from the dead, again."""
        deadline = time.monotonic() + TIMEOUT
        while True:
            try:
                return rospy.ServiceProxy(service, kind)(**fields)
            except (rospy.ServiceException, rospy.ROSException, OSError) as error:
                if time.monotonic() > deadline:
                    raise Broken(f"{service} does not answer: {error}") from None
                self.tick(0.1)
                time.sleep(0.1)

    def command(self, word: str) -> Any:
        """Gives one command of a person and returns its answer."""
        answer = self.call(names.COMMAND, Command, command=word, source="soak")
        self.codes[f"{word}: {answer.code}"] += 1
        if not answer.success and not answer.code:
            raise Broken(f"{word} was refused without a code: {answer.message!r}")
        return answer

    def tell_map(self) -> None:
        """Publishes the floor's map, as map_server does."""
        grid = GridMap(self.maps[self.floor], RESOLUTION, (0.0, 0.0, 0.0))
        self.map.publish(message_from_grid(grid, rospy.Time.from_sec(self.now)))

    # ------------------------------------------------------------ faults
    def kill(self, name: str) -> None:
        """Kills a node as a crash does."""
        pid = self._pid(name)
        if pid is None:
            return  # it is just being restarted
        os.kill(pid, signal.SIGKILL)
        self.counts[f"killed {name}"] += 1
        self.wait(lambda: self._pid(name) not in (None, pid), f"{name} back from the dead", ticking=True)
        self.settle()

    @staticmethod
    def _pid(name: str) -> Optional[int]:
        try:
            uri = rosgraph.Master("/soak").lookupNode(f"/{name}")
            return xmlrpc.client.ServerProxy(uri).getPid("/soak")[2]
        except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
            return None

    def unplug(self) -> None:
        """Unplugs the computer of a camera for a while: people must be told, and told again when it is back."""
        camera = str(self.rng.choice(CAMERAS))
        self.plugged[camera] = False
        self.notice_delays.append(self._until_told("detector_missing", camera))
        self.plugged[camera] = True
        self._until_told("detector_missing", camera, told=False)
        self.counts["unplugged"] += 1

    def _until_told(self, code: str, camera: str, told: bool = True) -> float:
        """Waits until people are told of a fault, or that it is over; returns after how long [s] of simulated time."""
        began = self.now
        while ((code, camera) in self.notices.get("/camera_poses", ())) != told:
            self.tick(0.1)
            time.sleep(0.01)
            if self.now - began > 3 * NOTICED_S:
                raise Broken(f"notice {code} about camera {camera} was not {'given' if told else 'withdrawn'}")
        return self.now - began

    def step_clock(self) -> None:
        """Sets the clock, forwards or a little back."""
        jump = float(self.rng.choice([-5.0, -1.0, 30.0, 3600.0]))
        self.tick(jump)
        self.counts[f"clock {jump:+g} s"] += 1
        self.idle(3.0)

    def change_floor(self) -> None:
        """Moves the robot to the other floor; the borders of this one must be there when it comes back."""
        self.floor = next(name for name in self.maps if name != self.floor)
        self.newest.pop("posterior", None)
        self.tell_map()
        self.wait(self._posterior_is_of_this_floor, f"the map of the {self.floor}", ticking=True)
        self.counts["floor changed"] += 1
        if self.heard("borders", lambda array: array.needs_confirmation):
            # both floors have the same outer walls: until somebody says which one it is, the other's borders stay in
            # force
            self.call(
                names.CONFIRM_MAP, ConfirmMap, answer=ConfirmMapRequest.OTHER_PLACE, name=self.floor, source="soak"
            )
            self.counts["floor told"] += 1

    def night(self) -> None:
        """Switches everything off and on again."""
        self.down()
        self.newest.clear()
        self.up()
        self.settle()
        self.counts["restarted"] += 1


def points_of(border: Any) -> Any:
    return np.array([(point.x, point.y) for point in border.points])
