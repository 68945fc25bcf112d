"""Shared by the views of both kinds of cameras: moving bodies, the laser's light, the random generator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Callable, Dict, List, Optional, Tuple

import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.geometry import Pose
from vb_sim.lab_history import Snapshot
from vb_sim.model_params import Models, make_generator
from vb_sim.rendering import bodies
from vb_sim.rendering.laser_spot import SpotImage, add_spot, render_spot

_PERSON_RADIUS = 0.26  # [m] of the average person's shadow


@dataclass(frozen=True)
class Body:
    """A person or robot that moves.

    Attributes:
        key: the same for bodies that look the same.
        build: builds the body's pieces.
        pose: (x, y, yaw) [m, m, rad].
        radius: [m] radius of the body's shadow.
    """

    name: str
    key: Tuple
    build: Callable[[], bodies.BodyParts]
    pose: Pose
    radius: float


class View:
    """Renders the images of a camera.

    Args:
        name: the view's name; the noise differs between names.
        model: the camera.
        encoding: the images' encoding, as named in sensor_msgs.
        radii: radius [m] of each robot by its name.
        models: parameters of optics and noise.
        seed: seed of the noise.
        full_well_e: [electrons] at 255, which determines the photon noise.
    """

    def __init__(
        self,
        name: str,
        model: CameraModel,
        encoding: str,
        radii: Dict[str, float],
        models: Models,
        seed: int,
        full_well_e: float,
    ) -> None:
        self.model, self.encoding = model, encoding
        self._radii, self._optics, self._full_well_e = radii, models.optics, full_well_e
        self._body, self._hand_height = models.body, models.hand_height
        self._rng = make_generator(seed, name)

    def frame(self, snapshot: Snapshot) -> np.ndarray:
        """Renders the image of a scene, (H, W) or (H, W, 3) uint8. The next call may change it."""
        raise NotImplementedError

    def camera_pose(self, snapshot: Snapshot) -> np.ndarray:
        """Returns T_map_optical, 4x4."""
        raise NotImplementedError

    def restart(self, models: Models) -> None:
        """Resets the moving objects for another person in the same room. `models` may differ only in the body."""
        self._body, self._hand_height = models.body, models.hand_height

    def set_noise_generator(self, source: np.random.Generator) -> None:
        """Replaces the noise's random generator, so that frames do not depend on earlier ones."""
        self._rng = source

    def _bodies(self, snapshot: Snapshot) -> List[Body]:
        """Lists the moving bodies of a scene. Bodies that look the same have the same name and key."""
        result = []
        for name, pose in snapshot.robots.items():
            radius = self._radii.get(name, 0.18)
            build = partial(bodies.robot_pieces, pose, radius)
            result.append(Body(name, bodies.robot_key(pose), build, pose, radius))
        person, laser = snapshot.person, snapshot.laser
        if person is not None:
            key = bodies.person_key(person, laser)
            radius = _PERSON_RADIUS * self._body.breadth
            build = partial(bodies.person_pieces, person, laser, self._hand_height, self._body)
            result.append(Body("person", key, build, person, radius))
        return result

    # ------------------------------------------------------------- the laser
    def spot(self, snapshot: Snapshot) -> Optional[SpotImage]:
        """Renders the light of the spot as if nothing hid it. Returns None if the laser is off or out of view."""
        if snapshot.laser is None:
            return None
        person, pose = snapshot.person, self.camera_pose(snapshot)
        source = bodies.hand_position(person, snapshot.laser, self._hand_height) if person is not None else None
        return render_spot(snapshot.laser, snapshot.laser_velocity, source, self.model, pose, self._optics)

    def spot_share(self, snapshot: Snapshot) -> float:
        """Returns the share of the laser's light on the floor that reaches the camera. Call `frame` first."""
        spot = self.spot(snapshot)
        return 0.0 if spot is None else self._visible(spot)

    def _visible(self, spot: SpotImage) -> float:
        """Returns the visible share of a spot's light; 0 if its centre is hidden or outside the image."""
        column, row = spot.pixel
        floor = self._floor_is_free()
        if not (0 <= column < self.model.width and 0 <= row < self.model.height and floor[row, column]):
            return 0.0
        return float(floor[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2].mean())

    def _floor_is_free(self) -> np.ndarray:
        """Returns (H, W): the pixels in which nothing hides the floor."""
        raise NotImplementedError

    def _albedo(self, spot: SpotImage) -> np.ndarray:
        """Returns the colour (3,) of the floor below a spot; 1 is white."""
        raise NotImplementedError

    def _add_light(self, image: np.ndarray, snapshot: Snapshot, exposure: float = 1.0) -> None:
        """Adds the laser's light to an image, in place.

        Args:
            exposure: the camera's exposure, as a multiple of the image's.
        """
        spot = self.spot(snapshot)
        visible = 0.0 if spot is None else self._visible(spot)
        if visible < 0.01:
            return
        weights = visible * exposure * self._albedo(spot) * self._optics.response(snapshot.laser_color)
        self._before_change(image, spot.area)
        add_spot(image, spot, weights, self.encoding, self._full_well_e, self._rng)

    def _before_change(self, image: np.ndarray, area: Tuple[slice, slice]) -> None:
        """Is called before an area of an image is changed."""
