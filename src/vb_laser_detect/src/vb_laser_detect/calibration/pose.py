"""The pose of a ceiling camera in the map, from points on the floor whose places in the map and in the image are known.

Consensus over minimal sets of four points finds what fits together (RANSAC; Fischler and Bolles, 1981), each set solved
by IPPE (Collins and Bartoli, 2014). Least squares over everything that fits gives the pose, and its covariance says how
far off a spot on the floor can be. Input that does not determine a pose is refused.
"""
from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import List, Optional, Sequence, Tuple

import cv2
import numpy as np

from vb_core import geometry
from vb_core.camera_model import CameraModel
from vb_core.errors import CodedError
from vb_core.parameters import Parameters, param
from vb_laser_detect.detection.projection import floor_points

LEAST_POINTS = 4
_MOST_SETS = 200  # minimal sets tried; with 40 % wrong points 50 are enough for one without any, at 99.9 %
_PROMISING = 10  # of them are solved again, more exactly
_SAME_PLACE = 0.005  # of the image's diagonal; points nearer to each other are one place, seen twice
_SAME_PLACE_M = 0.01
_SAME_TURN = math.radians(2.0)  # solutions that differ by less are one
_LIKELY = 9.0  # difference of chi square within which two poses are both plausible: 3 sigma


@dataclass(frozen=True)
class CalibrationParams(Parameters):
    """Accuracy of the measurements, and required quality of the result."""

    pixel_sigma: float = param(0.3, "px", above=0.0, high=20.0, doc="of a point in the image")
    point_sigma: float = param(0.015, "m", low=0.0, high=0.5, doc="of a point in the map that is measured by itself")
    placement_sigma: float = param(0.005, "m", above=0.0, high=0.5, doc="of each of the two points of a board")
    outlier: float = param(0.06, "m", above=0.0, high=1.0, doc="a point farther off on the floor does not count")
    min_agreeing: float = param(0.6, "", low=0.0, high=1.0, doc="part of the points that has to agree on one pose")
    min_area: float = param(0.025, "of the image", low=0.0, high=1.0, doc="that the points span")
    max_floor_sigma: float = param(0.1, "m", above=0.0, high=1.0, doc="uncertainty on the floor, anywhere in the image")
    floor_height: float = param(0.0, "m", low=-10.0, high=10.0, doc="of the floor in the map frame")


@dataclass(frozen=True)
class Observations:
    """Points on the floor as one camera sees them.

    Attributes:
        pixels: (N, 2) [px]
        points: (N, 2) [m], map frame.
        placements: (N,) which points share one measured place, for instance the corners of a board laid once;
            -1 for points that were measured one by one.
    """

    pixels: np.ndarray
    points: np.ndarray
    placements: np.ndarray

    def __post_init__(self) -> None:
        for name, shape, kind in (("pixels", (-1, 2), float), ("points", (-1, 2), float), ("placements", (-1,), int)):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=kind).reshape(shape))
        if not len(self.pixels) == len(self.points) == len(self.placements):
            raise CodedError("bad_points", f"{len(self.pixels)} pixels, but {len(self.points)} points in the map")

    @staticmethod
    def single(pixels: np.ndarray, points: np.ndarray) -> "Observations":
        """Points that were measured one by one."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        return Observations(pixels, points, np.full(len(points), -1))

    @staticmethod
    def boards(placed: Sequence[Tuple[np.ndarray, np.ndarray]]) -> "Observations":
        """(pixels, points) of a board in each of its places."""
        if not placed:
            return Observations.single(np.zeros((0, 2)), np.zeros((0, 2)))
        pixels, points = (np.vstack([np.asarray(part[i], float).reshape(-1, 2) for part in placed]) for i in (0, 1))
        return Observations(pixels, points, np.concatenate([np.full(len(p), i) for i, (_, p) in enumerate(placed)]))

    def select(self, mask: np.ndarray) -> "Observations":
        """A subset."""
        return Observations(self.pixels[mask], self.points[mask], self.placements[mask])

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True)
class PoseEstimate:
    """A camera's pose and how well it is known.

    Attributes:
        T_map_camera: (4, 4) pose of the optical frame in the map frame.
        used: (N,) bool, which observations agree with it.
        errors_px: (N,) [px] distance in the image between a point and where the pose puts it.
        errors_m: (N,) [m] the same on the floor.
        position_sigma: (3,) [m] standard deviations along the map's axes.
        angle_sigma: (3,) [rad] standard deviations about the camera's axes.
        floor_sigma: (middle, worst) [m] standard deviation of a spot on the floor from the pose's uncertainty, in the
            middle of the image and at the worst place of it.
    """

    T_map_camera: np.ndarray
    used: np.ndarray
    errors_px: np.ndarray
    errors_m: np.ndarray
    position_sigma: np.ndarray
    angle_sigma: np.ndarray
    floor_sigma: Tuple[float, float]

    @property
    def rms_px(self) -> float:
        """[px] of the points used."""
        return float(np.sqrt(np.mean(self.errors_px[self.used] ** 2)))

    @property
    def rms_m(self) -> float:
        """[m] on the floor, of the points used."""
        return float(np.sqrt(np.mean(self.errors_m[self.used] ** 2)))


def estimate_pose(
    camera: CameraModel, observed: Observations, params: Optional[CalibrationParams] = None
) -> PoseEstimate:
    """Finds the pose from where the camera sees the points.

    Raises:
        CodedError: "bad_points", "outside_image", "too_few_points", "collinear", "clustered" for points that cannot
            determine a pose; "no_agreement" where no pose explains enough of them; "below_floor" if the camera would be
            under it; "ambiguous" if two poses explain them; "uncertain" if the pose is known too poorly.
    """
    params = params or CalibrationParams()
    check_points(camera, observed, params)
    start, used = _consensus(camera, observed, params)
    if used.sum() < max(LEAST_POINTS, params.min_agreeing * len(observed)):
        raise CodedError(
            "no_agreement",
            f"only {int(used.sum())} of {len(observed)} points agree on a pose to {100 * params.outlier:.0f} cm: check "
            "the places in the map, their order, and the camera's lens calibration",
        )
    check_points(camera, observed.select(used), params)
    # what agrees may change once all that agrees has been used
    for _ in range(5):
        fit = _Fit(camera, observed.select(used), params, start)
        errors = errors_on_floor(camera, fit.T_map_camera, observed, params.floor_height)
        agreeing = errors < params.outlier
        if (agreeing == used).all() or agreeing.sum() < LEAST_POINTS:
            break
        used, start = agreeing, fit.T_map_camera
    if fit.T_map_camera[2, 3] <= params.floor_height:
        raise CodedError(
            "below_floor",
            f"the camera would be at z = {fit.T_map_camera[2, 3]:.2f} m, under the floor: the points are mirrored; "
            "check the map's axes and the order of the points",
        )
    _refuse_if_ambiguous(camera, observed.select(used), params, fit)
    middle, worst = floor_uncertainty(camera, fit.T_map_camera, fit.covariance, params.floor_height)
    if worst > params.max_floor_sigma:
        raise CodedError(
            "uncertain",
            f"a spot could be wrong by {100 * worst:.1f} cm (1 sigma) at the image's worst place, at most "
            f"{100 * params.max_floor_sigma:.1f} cm are wanted: add points far from those there are",
        )
    reprojected = _project(camera, fit.T_map_camera, observed.points, params.floor_height)
    sigma = np.sqrt(np.diag(fit.covariance))
    # an error of the camera's position is one of T_camera_map's translation, turned into the map
    in_map = fit.T_map_camera[:3, :3]
    return PoseEstimate(
        T_map_camera=fit.T_map_camera,
        used=errors_on_floor(camera, fit.T_map_camera, observed, params.floor_height) < params.outlier,
        errors_px=np.linalg.norm(reprojected - observed.pixels, axis=1),
        errors_m=errors_on_floor(camera, fit.T_map_camera, observed, params.floor_height),
        position_sigma=np.sqrt(np.diag(in_map @ fit.covariance[3:, 3:] @ in_map.T)),
        angle_sigma=sigma[:3],
        floor_sigma=(middle, worst),
    )


def check_points(camera: CameraModel, observed: Observations, params: CalibrationParams) -> None:
    """Refuses points that cannot determine any pose.

    Raises:
        CodedError: "bad_points", "outside_image", "too_few_points", "collinear", "clustered".
    """
    if not (np.isfinite(observed.pixels).all() and np.isfinite(observed.points).all()):
        raise CodedError("bad_points", "some coordinates are no numbers")
    if not camera.contains(observed.pixels).all():
        raise CodedError("outside_image", f"some points lie outside the image of {camera.width} x {camera.height}")
    if len(observed) < LEAST_POINTS:
        raise CodedError("too_few_points", f"{len(observed)} points; at least {LEAST_POINTS} are needed, 6 are good")
    near_px = _SAME_PLACE * math.hypot(camera.width, camera.height)
    for values, near, what in ((observed.points, _SAME_PLACE_M, "map"), (observed.pixels, near_px, "image")):
        different = _different(values, near)
        if different < LEAST_POINTS:
            reason = f"{len(observed)} points, but in the {what} only {different} different places"
            raise CodedError("too_few_points", f"{reason}; at least {LEAST_POINTS} are needed")
        along, across = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
        if across < 0.1 * along:
            raise CodedError("collinear", f"the points lie on one line in the {what}: add some beside it")
    hull = cv2.convexHull(observed.pixels.astype(np.float32))
    share = cv2.contourArea(hull) / (camera.width * camera.height)
    if share < params.min_area:
        raise CodedError(
            "clustered",
            f"the points span {100 * share:.1f} % of the image, {100 * params.min_area:.1f} % are needed: "
            "spread them over what the camera sees",
        )


def _different(values: np.ndarray, near: float) -> int:
    """How many of values (N, 2) are not near to one counted before; counted up to what is needed."""
    counted = values[:0]
    for value in values:
        if len(counted) < LEAST_POINTS and (np.linalg.norm(counted - value, axis=1) > near).all():
            counted = np.vstack([counted, value])
    return len(counted)


def errors_on_floor(camera: CameraModel, T_map_camera: np.ndarray, observed: Observations, height: float) -> np.ndarray:
    """(N,) [m] between points and the floor points of their pixels; inf where a ray misses the floor."""
    return _off_floor(T_map_camera, camera.rays(observed.pixels), observed.points, height)


def _off_floor(T_map_camera: np.ndarray, rays: np.ndarray, points: np.ndarray, height: float) -> np.ndarray:
    seen = geometry.intersect_floor(T_map_camera[:3, 3], rays @ T_map_camera[:3, :3].T, height)[:, :2]
    errors = np.linalg.norm(seen - points, axis=1)
    return np.where(np.isfinite(errors), errors, np.inf)


def floor_uncertainty(
    camera: CameraModel, T_map_camera: np.ndarray, covariance: np.ndarray, height: float
) -> Tuple[float, float]:
    """(middle, worst) [m] standard deviation of a floor point, in its worst direction, from a pose's uncertainty.

    Args:
        covariance: (6, 6) of a rotation vector and a shift, both in the camera's frame [rad, m].
    """
    columns, rows = (np.array([0.05, 0.5, 0.95]) * (size - 1) for size in (camera.width, camera.height))
    pixels = np.array([(u, v) for v in rows for u in columns])
    step = 1e-5
    derivative = np.stack(
        [
            floor_points(camera, _moved(T_map_camera, step * axis), pixels, height)[:, :2]
            - floor_points(camera, _moved(T_map_camera, -step * axis), pixels, height)[:, :2]
            for axis in np.eye(6)
        ],
        axis=2,
    ) / (2 * step)
    seen = np.isfinite(derivative).all(axis=(1, 2))
    if not seen.any():
        return math.inf, math.inf
    spread = derivative[seen] @ covariance @ derivative[seen].transpose(0, 2, 1)
    sigma = np.full(len(pixels), np.nan)
    sigma[seen] = np.sqrt(np.maximum(0.0, np.linalg.eigvalsh(spread)[:, -1]))
    middle = sigma[4] if seen[4] else np.nanmin(sigma)
    return float(middle), float(np.nanmax(sigma))


def _moved(T_map_camera: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """A pose turned by a rotation vector and shifted, (6,) [rad, m], both in the camera's own frame."""
    return T_map_camera @ geometry.transform(cv2.Rodrigues(np.asarray(delta[:3], float))[0], delta[3:])


def _project(camera: CameraModel, T_map_camera: np.ndarray, points: np.ndarray, height: float) -> np.ndarray:
    on_floor = np.column_stack([points, np.full(len(points), height)])
    return camera.project(geometry.apply(geometry.invert(T_map_camera), on_floor))


def _planar_poses(rays: np.ndarray, points: np.ndarray, height: float, polish: bool = False) -> List[np.ndarray]:
    """T_map_camera of the one or two poses from which points (N, 2) of the floor lie on rays (N, 3).

    IPPE uses a homography, which is poorly determined if three of four points are nearly collinear; `polish` adds
    least-squares steps, at twenty times the cost.
    """
    # the solver needs its plane at z = 0 and the points around the origin
    centre = np.array([*points.mean(axis=0), height])
    plane = np.column_stack([points - centre[:2], np.zeros(len(points))])
    try:
        found, rotations, shifts, _ = cv2.solvePnPGeneric(
            plane, rays[:, None, :2], np.eye(3), np.zeros(5), flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:  # points that are not planar after all
        return []
    poses = []
    for rotation, shift in zip(rotations, shifts) if found else ():
        if polish:
            rotation, shift = cv2.solvePnPRefineLM(plane, rays[:, None, :2], np.eye(3), np.zeros(5), rotation, shift)
        if np.isfinite(rotation).all() and np.isfinite(shift).all():
            pose = geometry.invert(geometry.transform(cv2.Rodrigues(rotation)[0], shift.ravel()))
            pose[:3, 3] += centre
            poses.append(pose)
    return poses


def _consensus(camera: CameraModel, observed: Observations, params: CalibrationParams) -> Tuple[np.ndarray, np.ndarray]:
    """(T_map_camera, (N,) bool which points agree) of the pose that most points agree on.

    The cost of a point grows with its error up to the limit (MSAC; Torr and Zisserman, 2000): counting alone could not
    tell a good pose from a bad one that the same points just agree with.
    """
    rays = camera.rays(observed.pixels)

    def ranked(sets: Sequence[np.ndarray], polish: bool) -> List[Tuple[float, np.ndarray, np.ndarray]]:
        result = []
        for chosen in sets:
            for pose in _planar_poses(rays[chosen], observed.points[chosen], params.floor_height, polish):
                errors = _off_floor(pose, rays, observed.points, params.floor_height) / params.outlier
                result.append((float((np.minimum(errors, 1.0) ** 2).sum()), pose, chosen))
        return sorted(result, key=lambda entry: entry[0])

    promising = [chosen for _, _, chosen in ranked(_minimal_sets(observed), False)[:_PROMISING]]
    best = ranked(promising, True)
    if not best:
        raise CodedError("no_agreement", "no pose explains any four of the points: check the places in the map")
    pose = best[0][1]
    return pose, _off_floor(pose, rays, observed.points, params.floor_height) < params.outlier


def _minimal_sets(observed: Observations) -> List[np.ndarray]:
    """Sets of four points that span something; all of them where they are few, else a fixed random choice."""
    count = len(observed)
    if math.comb(count, 4) <= _MOST_SETS:
        return [np.array(chosen) for chosen in itertools.combinations(range(count), 4)]
    random = np.random.default_rng(0)
    sets = [random.choice(count, 4, replace=False) for _ in range(4 * _MOST_SETS)]
    # the wider a set is spread, the less its own noise matters
    spread = [cv2.contourArea(cv2.convexHull(observed.points[chosen].astype(np.float32))) for chosen in sets]
    return [sets[i] for i in np.argsort(spread)[::-1][:_MOST_SETS]]


class _Fit:
    """Least squares for the pose and each board's true place, weighted by the measurements' accuracy.

    Attributes:
        T_map_camera: (4, 4)
        covariance: (6, 6) of a rotation vector and a shift, both in the camera's frame [rad, m].
        chi_square: of the measurements, robust.
    """

    def __init__(
        self, camera: CameraModel, observed: Observations, params: CalibrationParams, start: np.ndarray
    ) -> None:
        self._camera, self._observed, self._params, self._start = camera, observed, params, start
        boards = sorted(set(observed.placements.tolist()) - {-1})
        self._groups = [np.flatnonzero(observed.placements == board) for board in boards]
        alone = observed.placements == -1
        per_metre = self._pixels_per_metre()
        self._sigma = np.hypot(params.pixel_sigma, np.where(alone, params.point_sigma * per_metre, 0.0))
        self._board_sigma = np.array([self._placement_sigma(group) for group in self._groups]).reshape(-1, 3)
        # points that agree with the pose can still be off: soft_l1 gives those beyond 2 sigma less weight
        x0 = np.zeros(6 + 3 * len(self._groups))
        from scipy.optimize import least_squares  # programs that only read calibrations do without its 20 MiB

        solution = least_squares(self._residuals, x0, method="trf", loss="soft_l1", f_scale=2.0, x_scale="jac")
        self.T_map_camera = _moved(start, solution.x[:6])
        self.chi_square = float(2.0 * solution.cost)
        freedom = 2 * len(observed) - 6
        # measurements worse than stated make the pose less certain; better ones prove nothing
        factor = max(1.0, self.chi_square / freedom)
        information = solution.jac.T @ solution.jac
        self.covariance = factor * np.linalg.pinv(information)[:6, :6]

    def _residuals(self, x: np.ndarray) -> np.ndarray:
        points = self._observed.points.copy()
        moves = x[6:].reshape(-1, 3)
        for group, move in zip(self._groups, moves):
            centre = points[group].mean(axis=0)
            c, s = math.cos(move[2]), math.sin(move[2])
            points[group] = centre + move[:2] + (points[group] - centre) @ np.array([[c, s], [-s, c]])
        seen = _project(self._camera, _moved(self._start, x[:6]), points, self._params.floor_height)
        # a pose that has a point behind it must be worse than any other
        off = np.where(np.isfinite(seen), seen - self._observed.pixels, 1e4) / self._sigma[:, None]
        return np.concatenate([off.ravel(), (moves / self._board_sigma).ravel()])

    def _pixels_per_metre(self) -> np.ndarray:
        step, points, height = 0.01, self._observed.points, self._params.floor_height
        here = _project(self._camera, self._start, points, height)
        steps = [_project(self._camera, self._start, points + step * axis, height) - here for axis in np.eye(2)]
        return np.nan_to_num(np.mean([np.linalg.norm(s, axis=1) for s in steps], axis=0) / step, nan=1.0)

    def _placement_sigma(self, group: np.ndarray) -> Tuple[float, float, float]:
        points, sigma = self._observed.points[group], self._params.placement_sigma
        length = max(0.05, float(np.ptp(points, axis=0).max()))
        return sigma / math.sqrt(2.0), sigma / math.sqrt(2.0), math.sqrt(2.0) * sigma / length


def _refuse_if_ambiguous(camera: CameraModel, observed: Observations, params: CalibrationParams, fit: _Fit) -> None:
    """A small or distant plane looks alike from two sides; the less likely one has to be clearly so."""
    for pose in _planar_poses(camera.rays(observed.pixels), observed.points, params.floor_height):
        if _turn(pose, fit.T_map_camera) < _SAME_TURN:
            continue
        other = _Fit(camera, observed, params, pose)
        if _turn(other.T_map_camera, fit.T_map_camera) > _SAME_TURN and other.chi_square < fit.chi_square + _LIKELY:
            raise CodedError(
                "ambiguous", "two different poses explain the points equally well: spread them wider over the image"
            )


def _turn(a: np.ndarray, b: np.ndarray) -> float:
    """[rad] between two poses."""
    return float(np.linalg.norm(cv2.Rodrigues(a[:3, :3].T @ b[:3, :3])[0]))
