"""What both kinds of cameras need to render images: moving bodies, the laser's light, a random generator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Callable, Dict, List, Optional, Tuple, Union

import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.geometry import Pose
from vb_sim.lab_history import Snapshot
from vb_sim.model_params import CameraNoise, Models, RobotCamera, make_generator
from vb_sim.rendering import bodies
from vb_sim.rendering.laser_spot import SpotImage, add_spot, render_spot

_PERSON_RADIUS = 0.26  # [m] of the average person's shadow


@dataclass(frozen=True)
class Body:
    """A person or robot that moves."""

    name: str
    key: Tuple  # the same for bodies that look the same
    build: Callable[[], bodies.BodyParts]  # builds the body's pieces
    pose: Pose  # (x, y, yaw) [m, m, rad]
    radius: float  # [m] of the body's shadow


class CameraView:
    """Renders the images of a camera.

    Args:
        name: the view's name; the noise differs between names.
        encoding: the images' encoding, as named in sensor_msgs.
        radii: radius [m] of each robot by its name.
        models: parameters of optics and people.
        noise: of the camera's sensor.
    """

    def __init__(
        self,
        name: str,
        model: CameraModel,
        encoding: str,
        radii: Dict[str, float],
        models: Models,
        noise: Union[CameraNoise, RobotCamera],
        seed: int,
    ) -> None:
        self.model = model
        self.encoding = encoding
        self._radii = radii
        self._models = models
        self._optics = models.optics
        self._noise_model = noise
        self._rng = make_generator(seed, name)
        self._object_ids = np.zeros((model.height, model.width), np.uint8)  # 0 where nothing hides the floor

    def image(self, snapshot: Snapshot) -> np.ndarray:
        """Renders the image of a scene, (H, W) or (H, W, 3) uint8. The next call may change it."""
        raise NotImplementedError

    def camera_pose(self, snapshot: Snapshot) -> np.ndarray:
        """Returns T_map_optical, 4x4."""
        raise NotImplementedError

    def restart(self, models: Models) -> None:
        """Resets the moving objects for another person in the same room. `models` may differ only in the body."""
        self._models = models

    def set_noise_generator(self, source: np.random.Generator) -> None:
        """Replaces the noise's random generator, so that images do not depend on earlier ones."""
        self._rng = source

    def _bodies(self, snapshot: Snapshot) -> List[Body]:
        """Lists the moving bodies of a scene. Bodies that look the same have the same name and key."""
        result = []
        for name, pose in snapshot.robots.items():
            radius = self._radii.get(name, 0.18)
            build = partial(bodies.robot_pieces, pose, radius)
            result.append(Body(name, bodies.robot_key(pose), build, pose, radius))
        person = snapshot.person
        if person is not None:
            key = bodies.person_key(person, snapshot.laser)
            proportions = self._models.body
            build = partial(bodies.person_pieces, person, snapshot.laser, self._models.hand_height, proportions)
            result.append(Body("person", key, build, person, _PERSON_RADIUS * proportions.breadth))
        return result

    # ------------------------------------------------------------- the laser
    def spot(self, snapshot: Snapshot) -> Optional[SpotImage]:
        """Renders the light of the spot as if nothing hid it. Returns None if the laser is off or out of view."""
        if snapshot.laser is None:
            return None
        source = None
        if snapshot.person is not None:
            source = bodies.hand_position(snapshot.person, snapshot.laser, self._models.hand_height)
        pose = self.camera_pose(snapshot)
        return render_spot(snapshot.laser, snapshot.laser_velocity, source, self.model, pose, self._optics)

    def spot_share(self, snapshot: Snapshot) -> float:
        """Returns the share of the laser's light on the floor that reaches the camera. Call `image` first."""
        spot = self.spot(snapshot)
        return 0.0 if spot is None else self._visible(spot)

    def _visible(self, spot: SpotImage) -> float:
        """Returns the visible share of a spot's light; 0 if its centre is hidden or outside the image."""
        column, row = spot.pixel
        is_in_image = 0 <= column < self.model.width and 0 <= row < self.model.height
        if not is_in_image or self._object_ids[row, column] != 0:
            return 0.0
        neighborhood = self._object_ids[max(0, row - 1) : row + 2, max(0, column - 1) : column + 2]
        return float((neighborhood == 0).mean())

    def _albedo(self, spot: SpotImage) -> np.ndarray:
        """Returns the colour (3,) of the floor below a spot; 1 is white."""
        raise NotImplementedError

    def _add_light(self, image: np.ndarray, snapshot: Snapshot, exposure: float = 1.0) -> None:
        """Adds the laser's light to an image, in place.

        Args:
            exposure: the camera's exposure, as a multiple of the exposure with which the image was rendered.
        """
        spot = self.spot(snapshot)
        visible = 0.0 if spot is None else self._visible(spot)
        if visible < 0.01:
            return
        weights = visible * exposure * self._albedo(spot) * self._optics.response(snapshot.laser_color)
        self._before_change(image, spot.area)
        add_spot(image, spot, weights, self.encoding, self._noise_model.full_well_e, self._rng)

    def _before_change(self, image: np.ndarray, area: Tuple[slice, slice]) -> None:
        """Does what a view needs before an area of an image is changed; here, nothing."""
