"""People and faults in a soak test: they draw, give up, edit; nodes die, clocks step; for soak.py."""

from __future__ import annotations

import os
import signal
import time
import xmlrpc.client
from typing import Any, Optional

import numpy as np
import rosgraph
import rospy
from std_srvs.srv import Trigger

from bench.lab.soak_stack import CAMERAS, NODES, RATE, SPEED, Broken, Stack
from vb_core import geometry, names
from vb_msgs.msg import LaserSpot, VirtualBorder
from vb_msgs.srv import ConfirmMap, ConfirmMapRequest, RemoveBorder


class People(Stack):
    """Those who draw and edit, and what happens to them."""

    def draw(self, points: np.ndarray) -> None:
        """Points the laser along (N, 2) [m]."""
        for point in points:
            for camera in CAMERAS:
                if self.rng.random() < 0.2:
                    continue
                x, y = point + self.rng.normal(0.0, 0.01, 2)
                spot = LaserSpot(camera=camera, confidence=1.0, projection=LaserSpot.GROUND_PLANE)
                spot.header.frame_id = names.MAP_FRAME
                spot.header.stamp = rospy.Time.from_sec(self.now)
                spot.position.x, spot.position.y = float(x), float(y)
                self.spots.publish(spot)
            self.tick(1.0 / RATE)
            time.sleep(0.002)

    def shape(self) -> Any:
        """Returns the corners of a rectangle somewhere on the floor, (4, 2) [m]."""
        center = self.rng.uniform([1.2, 1.0], [6.8, 4.0])
        half = self.rng.uniform(0.35, 0.8, 2)
        angle = self.rng.uniform(0, np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return center + (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half) @ turn.T

    def interaction(self) -> None:
        """Draws an area as a person; now and then a node dies meanwhile, or the person gives up."""
        corners = self.shape()
        begun = self.command("define_border")
        if not begun.success:
            raise Broken(f"define_border was refused: {begun.message} [{begun.code}]")
        identity = self.wait(lambda: self.heard("state", lambda state: state.interaction_id), "the interaction")
        self.wait(
            lambda: self.heard("progress", lambda progress: progress.interaction_id == identity),
            "the point set in Border",
        )
        path = geometry.resample_chain(np.vstack([corners, corners[:1]]), SPEED / RATE)
        half = len(path) // 2
        self.draw(path[:half])
        killed = str(self.rng.choice(NODES)) if self.rng.random() < 0.25 else ""
        if killed:
            self.kill(killed)
        self.draw(path[half:])
        if self.rng.random() < 0.1:
            self.command("cancel")
            self.counts["given up"] += 1
            return
        self.command("define_seed")
        self.draw(np.tile(corners.mean(axis=0), (25, 1)))
        self.wait(
            lambda: self.heard("progress", lambda progress: progress.has_seed or progress.code not in ("", "ok")),
            "the seed",
        )
        answer = self.command("save")
        for _ in range(3):
            # what the console tells a person to do then
            if answer.code not in ("no_response", "no_service"):
                break
            answer = self.command("save")
        if not answer.success:
            self.counts[f"save refused: {answer.code}"] += 1
            self.command("cancel")
            return
        self.counts["saved"] += 1
        identity = self.wait(
            lambda: self.heard("state", lambda state: state.name == "default" and state.last_border_id),
            "the border's id",
        )
        border = self.wait(
            lambda: self.heard("borders", lambda array: next((b for b in array.borders if b.id == identity), None)),
            f"border {identity} among the borders",
        )
        if border.kind != VirtualBorder.POLYGON:
            if killed != "border_fusion":
                raise Broken(f"border {identity} was drawn closed and is open, though no spot was lost")
            # spots were lost with their node: the person sees on the display that the line was not closed
            if not self.call(names.UNDO, Trigger).success:
                raise Broken("the newest border cannot be taken back")
            self.counts["not closed, taken back"] += 1
            return
        self.ledger[self.floor][identity] = points_of(border)

    def edit(self) -> None:
        """Removes a border, or takes back the newest change and makes it again."""
        known = self.ledger[self.floor]
        if not known:
            return
        if self.rng.random() < 0.5 or len(known) > 6:
            identity = str(self.rng.choice(sorted(known)))
            answer = self.call(names.REMOVE_BORDER, RemoveBorder, id=identity)
            if answer.success:
                self.removed = (identity, known.pop(identity))
                self.counts["removed"] += 1
                if len(known) < 10 and self.rng.random() < 0.5 and self.call(names.UNDO, Trigger).success:
                    known[self.removed[0]] = self.removed[1]
                    self.counts["undone"] += 1

    # ------------------------------------------------------------ faults
    def kill(self, name: str) -> None:
        """Kills a node as a crash does."""
        pid = self._pid(name)
        if pid is None:
            return  # it is just being restarted
        os.kill(pid, signal.SIGKILL)
        self.counts[f"killed {name}"] += 1
        self.wait(lambda: self._pid(name) not in (None, pid), f"{name} back from the dead")
        self.settle()

    @staticmethod
    def _pid(name: str) -> Optional[int]:
        try:
            uri = rosgraph.Master("/soak").lookupNode(f"/{name}")
            return xmlrpc.client.ServerProxy(uri).getPid("/soak")[2]
        except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
            return None

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
        self.wait(self.posterior_is_of_this_floor, f"the map of the {self.floor}")
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
