"""People in a soak test: they draw, give up, edit; for soak.py."""

from __future__ import annotations

import time
from typing import Any, Callable, Optional

import numpy as np
import rospy
from std_srvs.srv import Trigger

from vb_core import geometry, names
from vb_msgs.msg import LaserSpot, VirtualBorder
from vb_msgs.srv import RemoveBorder

from bench.lab.soak_life import Trouble, points_of
from bench.lab.soak_stack import CAMERAS, NODES, RATE, SPEED, Broken


class People(Trouble):
    """Those who draw and edit."""

    def draw(self, points: np.ndarray) -> None:
        """Points the laser along (N, 2) [m]."""
        for point in points:
            for camera in CAMERAS:
                if not self.plugged[camera] or self.rng.random() < 0.2:
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

    def interaction(self, meanwhile: Optional[Callable[[], None]] = None) -> None:
        """Draws an area as a person; now and then somebody kills a node meanwhile, or the person gives up.

        Args:
            meanwhile: what happens in the middle of the border; left out: mostly nothing.
        """
        corners = self.shape()
        begun = self.command("define_border")
        if not begun.success:
            raise Broken(f"define_border was refused: {begun.message} [{begun.code}]")
        identity = self.wait(
            lambda: self.heard("state", lambda state: state.interaction_id), "the interaction", ticking=True
        )
        self.wait(
            lambda: self.heard("progress", lambda progress: progress.interaction_id == identity),
            "the point set in Border",
            ticking=True,
        )
        path = geometry.resample_chain(np.vstack([corners, corners[:1]]), SPEED / RATE)
        trouble = meanwhile is None and self.rng.random() < 0.25
        half = len(path) // 2
        self.draw(path[:half])
        killed = str(self.rng.choice(NODES)) if trouble else ""
        if killed:
            self.kill(killed)
        if meanwhile is not None:
            meanwhile()
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
            ticking=True,
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
            ticking=True,
        )
        border = self.wait(
            lambda: self.heard("borders", lambda array: next((b for b in array.borders if b.id == identity), None)),
            f"border {identity} among the borders",
            ticking=True,
        )
        if border.kind != VirtualBorder.POLYGON:
            if killed != "border_fusion" and meanwhile is None:
                raise Broken(f"border {identity} was drawn closed and is open, though no spot was lost")
            # spots were lost with their node or cable: the person sees on the display that the line was not closed
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

    def lights(self) -> None:
        """Switches the lights while a person draws: for a second and a half both cameras see spots everywhere."""

        def flicker() -> None:
            for _ in range(6):
                self.draw(self.rng.uniform([0.3, 0.3], [7.7, 4.7], (3, 2)))

        before = self.counts["saved"]
        self.interaction(flicker)
        self.counts["lights: saved" if self.counts["saved"] > before else "lights: not saved"] += 1

    def lose_poses(self) -> None:
        """The robot's transforms stop. The next interaction must not wait for them."""
        self.localized = False
        self.kill("map_integrator")  # which now knows no place of the robot
        self.interaction()
        self.localized = True
        self.counts["transforms lost"] += 1
