"""Estimates a ceiling camera's pose in the map from floor points whose positions in map and image are known.

Consensus over minimal sets of four points finds those that agree (RANSAC; Fischler and Bolles, 1981). Each set is solved
by IPPE (Collins and Bartoli, 2014). Least squares over all points that agree gives the pose, and its covariance says how
far off a spot on the floor can be. Input that does not determine a pose is refused. The floor is the map's plane z = 0.

>>> camera = CameraModel.ideal(1280, 720, 900.0)
>>> points = np.array([(-1.5, -0.8), (1.5, -0.8), (1.5, 0.8), (-1.5, 0.8), (0.3, 0.1)])  # [m] on the floor
>>> looking_down = geometry.make_transform(geometry.rotation_from_rpy(math.pi, 0, 0), (0, 0, 2.5))
>>> estimate = estimate_pose(camera, Correspondences(project(camera, looking_down, points), points))
>>> float(estimate.T_map_camera[2, 3].round(3))  # [m] the camera's height
2.5
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import List, NamedTuple, Tuple

import cv2
import numpy as np

from vb_core import geometry
from vb_core.camera_model import CameraModel, project_to_floor, intersect_floor, project_to_pixels
from vb_core.errors import CodedError

MIN_POINTS = 4
_MAX_SETS = 200  # minimal sets tried; with 40 % wrong points, one of 50 sets has none of them in 99.9 % of cases
# distances below which two points are one place that was seen twice
_SAME_PLACE_DIAGONALS = 0.005  # share of the image's diagonal
_SAME_PLACE_DISTANCE = 0.01  # [m] on the floor
_SAME_ORIENTATION = math.radians(2.0)  # poses that differ by less are the same
_PLAUSIBLE = 9.0  # difference of chi square within which two poses are both plausible: 3 sigma
_PIXEL_SIGMA = 0.3  # [px] standard deviation of a point in the image
POINT_SIGMA = 0.015  # [m] standard deviation of a point in the map that was clicked in RViz
_OUTLIER = 0.06  # [m] error on the floor above which a point does not count
_MIN_AGREEING = 0.6  # share of the points that must agree on one pose
_MIN_AREA = 0.025  # share of the image that the points must span
_MAX_FLOOR_SIGMA = 0.1  # [m] uncertainty on the floor, anywhere in the image
# the corners of a rectangle
_CLICK_SIGMA = 1.0  # [px] how exactly a person marks a corner
_FOCALS = np.geomspace(0.3, 3.0, 48)  # focal lengths that are tried, in widths of the image
_USUAL_FOCAL = 0.75  # focal length of webcams and phones, in widths of the image
_FOCAL_SIGMA = 0.35  # deviation of the focal length's logarithm from the usual one's
_MAX_CORNER_ERROR = 0.02  # share of the image's diagonal, above which corners are no rectangle, or in disorder
_CLICK_DRAWS = 16  # random draws of inexact clicks


@dataclass(frozen=True)
class Correspondences:
    """Points on the floor as one camera sees them."""

    pixels: np.ndarray  # (N, 2) [px] where the camera sees them
    points: np.ndarray  # (N, 2) [m] the same points in the map frame

    def __post_init__(self) -> None:
        for name in ("pixels", "points"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), float).reshape(-1, 2))

    def select(self, chosen: np.ndarray) -> "Correspondences":
        """Returns some of the points, by indices or (N,) bool."""
        return Correspondences(self.pixels[chosen], self.points[chosen])

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True)
class PoseEstimate:
    """A camera's pose and how well it is known.

    Attributes:
        T_map_camera: (4, 4) pose of the optical frame in the map frame.
        used: (N,) bool, which observations agree with it.
        errors_px: (N,) [px] distance in the image between each point's pixel and its projection.
        errors_m: (N,) [m] distance on the floor between each point and its pixel's ray.
        floor_sigma: (middle, worst) [m] standard deviation of a spot on the floor due to the pose's uncertainty, in the
            middle of the image and at its worst place.
    """

    T_map_camera: np.ndarray
    used: np.ndarray
    errors_px: np.ndarray
    errors_m: np.ndarray
    floor_sigma: Tuple[float, float]

    @property
    def rms_px(self) -> float:
        """Root mean square error [px] of the points used, in the image."""
        return float(np.sqrt(np.mean(self.errors_px[self.used] ** 2)))

    @property
    def rms_m(self) -> float:
        """Root mean square error [m] of the points used, on the floor."""
        return float(np.sqrt(np.mean(self.errors_m[self.used] ** 2)))


def estimate_pose(camera: CameraModel, observed: Correspondences, point_sigma: float = POINT_SIGMA) -> PoseEstimate:
    """Estimates the pose from observed points, whose positions in the map are known to `point_sigma` [m].

    Raises:
        CodedError: "outside_image", "too_few_calibration_points", "collinear", "clustered" for points that cannot
            determine a pose; "no_consistent_pose" where no pose explains enough of them;
            "below_floor" if the camera would be below the floor; "ambiguous" if two poses explain the points;
            "uncertain" if the pose is known too poorly.
    """
    check_points(camera, observed)
    rays = camera.pixels_to_rays(observed.pixels)
    start = _consensus(rays, observed.points)
    used = errors_on_floor(start, rays, observed.points) < _OUTLIER
    used_count = int(used.sum())
    if used_count < max(MIN_POINTS, _MIN_AGREEING * len(observed)):
        raise CodedError("no_consistent_pose", agreeing=used_count, points=len(observed), cm=f"{100 * _OUTLIER:.0f}")
    check_points(camera, observed.select(used))
    # a fit to all points that agree may change which ones agree
    for _ in range(5):
        fit = _fit(camera, observed.select(used), point_sigma, start)
        errors = errors_on_floor(fit.T_map_camera, rays, observed.points)
        agreeing = errors < _OUTLIER
        if (agreeing == used).all() or agreeing.sum() < MIN_POINTS:
            break
        used, start = agreeing, fit.T_map_camera
    if fit.T_map_camera[2, 3] <= 0.0:
        raise CodedError("below_floor", z=f"{fit.T_map_camera[2, 3]:.2f}")
    _refuse_if_ambiguous(camera, observed.select(used), point_sigma, fit)
    middle, worst = floor_uncertainty(camera, fit.T_map_camera, fit.covariance)
    if worst > _MAX_FLOOR_SIGMA:
        raise CodedError("uncertain", cm=f"{100 * worst:.1f}", most=f"{100 * _MAX_FLOOR_SIGMA:.0f}")
    errors_px = np.linalg.norm(project(camera, fit.T_map_camera, observed.points) - observed.pixels, axis=1)
    return PoseEstimate(fit.T_map_camera, agreeing, errors_px, errors, (middle, worst))


def check_points(camera: CameraModel, observed: Correspondences) -> None:
    """Refuses points that cannot determine any pose.

    Raises:
        CodedError: "outside_image", "too_few_calibration_points", "collinear", "clustered".
    """
    if not camera.contains(observed.pixels).all():
        raise CodedError("outside_image", size=f"{camera.width} x {camera.height}")
    same_place_px = _SAME_PLACE_DIAGONALS * math.hypot(camera.width, camera.height)
    places = min(_count_places(observed.points, _SAME_PLACE_DISTANCE), _count_places(observed.pixels, same_place_px))
    if places < MIN_POINTS:
        raise CodedError("too_few_calibration_points", different=places, points=len(observed), least=MIN_POINTS)
    for values in (observed.points, observed.pixels):
        along, across = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
        if across < 0.1 * along:
            raise CodedError("collinear")
    share = cv2.contourArea(cv2.convexHull(observed.pixels.astype(np.float32))) / (camera.width * camera.height)
    if share < _MIN_AREA:
        raise CodedError("clustered", percent=f"{100 * share:.1f}", least=f"{100 * _MIN_AREA:.1f}")


def _count_places(points: np.ndarray, same_place: float) -> int:
    """Counts the points (N, 2) that are farther than `same_place` from each earlier one."""
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    return int((~np.triu(distances <= same_place, 1).any(axis=0)).sum())


def errors_on_floor(T_map_camera: np.ndarray, rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns the distances (N,) [m] from points to where rays (N, 3) meet the floor, or inf where a ray misses it."""
    positions = intersect_floor(T_map_camera, rays)[:, :2]
    return np.nan_to_num(np.linalg.norm(positions - points, axis=1), nan=np.inf)


def floor_uncertainty(camera: CameraModel, T_map_camera: np.ndarray, covariance: np.ndarray) -> Tuple[float, float]:
    """Propagates a pose's uncertainty to the floor.

    Args:
        covariance: (6, 6) covariance of a rotation vector and a shift, both in the camera's frame [rad, m].

    Returns:
        (middle, worst) [m] standard deviation of a floor point in its worst direction.
    """
    shares = np.array([0.05, 0.5, 0.95])
    pixels = np.array([(u, v) for v in shares for u in shares]) * (camera.width - 1, camera.height - 1)
    step = 1e-5
    deltas = step * np.vstack([np.eye(6), -np.eye(6)])
    positions = [project_to_floor(camera, _move(T_map_camera, delta), pixels)[:, :2] for delta in deltas]
    derivatives = (np.stack(positions[:6], axis=2) - np.stack(positions[6:], axis=2)) / (2 * step)
    on_floor = np.isfinite(derivatives).all(axis=(1, 2))
    if not on_floor.any():
        return math.inf, math.inf
    derivatives = derivatives[on_floor]
    covariances = derivatives @ covariance @ derivatives.transpose(0, 2, 1)
    sigma = np.full(len(pixels), np.nan)
    sigma[on_floor] = np.sqrt(np.maximum(0.0, np.linalg.eigvalsh(covariances)[:, -1]))
    middle = sigma[4] if on_floor[4] else np.nanmin(sigma)
    return float(middle), float(np.nanmax(sigma))


def _move(T_map_camera: np.ndarray, delta: np.ndarray) -> np.ndarray:
    """Turns a pose by a rotation vector and shifts it, (6,) [rad, m], both in the camera's own frame."""
    return T_map_camera @ geometry.make_transform(cv2.Rodrigues(np.asarray(delta[:3], float))[0], delta[3:])


def project(camera: CameraModel, T_map_camera: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns the pixels (N, 2) of points (N, 2) [m] on the floor, or NaN where the camera does not see them."""
    return project_to_pixels(camera, T_map_camera, np.column_stack([points, np.zeros(len(points))]))


def planar_poses(rays: np.ndarray, points: np.ndarray) -> List[np.ndarray]:
    """Finds the one or two poses T_map_camera from which points (N, 2) of the floor lie on rays (N, 3).

    IPPE uses a homography, which three nearly collinear points determine poorly; so least squares refine the poses.
    """
    # the solver needs the points around the origin
    center = np.array([*points.mean(axis=0), 0.0])
    plane = np.column_stack([points, np.zeros(len(points))]) - center
    problem = plane, rays[:, None, :2], np.eye(3), np.zeros(5)
    try:
        solution_count, rotations, shifts, _ = cv2.solvePnPGeneric(*problem, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:  # points that are not planar after all
        return []
    poses = []
    solutions = zip(rotations, shifts) if solution_count else ()
    for rotation, shift in solutions:
        rotation, shift = cv2.solvePnPRefineLM(*problem, rotation, shift)
        if np.isfinite(rotation).all() and np.isfinite(shift).all():
            pose = geometry.invert_transform(geometry.make_transform(cv2.Rodrigues(rotation)[0], shift.ravel()))
            pose[:3, 3] += center
            poses.append(pose)
    return poses


def _consensus(rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Finds the pose T_map_camera that most points agree on, or NaN if no points determine one.

    A point's cost grows with its error up to a limit (MSAC, by Torr and Zisserman, 2000). Counting alone could not tell a
    good pose from a bad one that barely agrees with the same points.
    """
    best_pose = np.full((4, 4), np.nan)
    least_cost = math.inf
    for chosen in _minimal_sets(len(points)):
        # points beyond the range of the lens model agree with no pose
        if not np.isfinite(rays[chosen]).all():
            continue
        for pose in planar_poses(rays[chosen], points[chosen]):
            errors = errors_on_floor(pose, rays, points) / _OUTLIER
            cost = float((np.minimum(errors, 1.0) ** 2).sum())
            if cost < least_cost:
                best_pose, least_cost = pose, cost
    return best_pose


def _minimal_sets(count: int) -> List[np.ndarray]:
    """Returns sets of four of `count` points: all sets if they are few, else a fixed random choice."""
    if math.comb(count, 4) <= _MAX_SETS:
        return [np.array(chosen) for chosen in itertools.combinations(range(count), 4)]
    random = np.random.default_rng(0)
    return [random.choice(count, 4, replace=False) for _ in range(_MAX_SETS)]


class _Fit(NamedTuple):
    """A pose, its covariance (6, 6) in the parameters of `_move`, and the robust chi square of the measurements."""

    T_map_camera: np.ndarray
    covariance: np.ndarray
    chi_square: float


def _fit(camera: CameraModel, observed: Correspondences, point_sigma: float, start: np.ndarray) -> _Fit:
    """Fits the pose by least squares, weighted by the measurements' accuracy."""
    from scipy.optimize import least_squares  # here, because programs that only read calibrations save its 20 MiB

    # a point's error in the image comes from pixel and map; whitening (N, 2, 2) makes both directions independent
    pixels = project(camera, start, observed.points)
    shifts = [project(camera, start, observed.points + move) - pixels for move in point_sigma * np.eye(2)]
    spread = np.nan_to_num(np.stack(shifts, axis=2))
    covariances = _PIXEL_SIGMA**2 * np.eye(2) + spread @ spread.transpose(0, 2, 1)
    whitening = np.linalg.inv(np.linalg.cholesky(covariances))

    def residuals(delta: np.ndarray) -> np.ndarray:
        errors = project(camera, _move(start, delta), observed.points) - observed.pixels
        # a pose with a point behind the camera must be worse than any other
        errors = np.where(np.isfinite(errors), errors, 1e4)
        return np.einsum("nij,nj->ni", whitening, errors).ravel()

    # points that agree with the pose can still be off: soft_l1 gives those beyond 2 sigma less weight
    solution = least_squares(residuals, np.zeros(6), loss="soft_l1", f_scale=2.0, x_scale="jac")
    chi_square = float(2.0 * solution.cost)
    # measurements that are worse than stated make the pose less certain; better ones prove nothing
    factor = max(1.0, chi_square / (2 * len(observed) - 6))
    covariance = factor * np.linalg.pinv(solution.jac.T @ solution.jac)
    return _Fit(_move(start, solution.x), covariance, chi_square)


def _refuse_if_ambiguous(camera: CameraModel, observed: Correspondences, point_sigma: float, fit: _Fit) -> None:
    """Refuses a pose if another one is almost as likely. A small or distant plane looks alike in two orientations."""
    for pose in planar_poses(camera.pixels_to_rays(observed.pixels), observed.points):
        if _angle_between(pose, fit.T_map_camera) < _SAME_ORIENTATION:
            continue
        other = _fit(camera, observed, point_sigma, pose)
        is_other = _angle_between(other.T_map_camera, fit.T_map_camera) > _SAME_ORIENTATION
        if is_other and other.chi_square < fit.chi_square + _PLAUSIBLE:
            raise CodedError("ambiguous")


def _angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Returns the angle [rad] between the orientations of two poses (4, 4)."""
    return float(np.linalg.norm(cv2.Rodrigues(a[:3, :3].T @ b[:3, :3])[0]))


class PosedCamera(NamedTuple):
    """A camera and its pose (4, 4) in a map whose origin is the first corner, and whose x axis points to the second."""

    camera: CameraModel
    T_map_camera: np.ndarray


def estimate_camera_from_rectangle(
    pixels: np.ndarray, size: Tuple[float, float], image: Tuple[int, int]
) -> PosedCamera:
    """Estimates pose and focal length of the camera that sees the corners of a rectangle on the floor at these pixels.

    This is for a first try without a calibrated lens. The lens is assumed to be free of distortion, with its axis through
    the middle of the image. A rectangle determines the focal length only if it is seen at a slant (Zhang, 2000).
    Otherwise its value hardly matters, and a usual one is assumed.

    Args:
        pixels: (4, 2) [px] the corners, in order round the rectangle.
        size: [m] from the first corner to the second one, and from the second to the third.
        image: width and height of the image [px].

    Raises:
        CodedError: "bad_rectangle" if they cannot be the corners of such a rectangle on the floor.
    """
    pixels = np.asarray(pixels, float).reshape(4, 2)
    hull = cv2.convexHull(pixels.astype(np.float32), returnPoints=False)
    signed_area = float(cv2.contourArea(pixels.astype(np.float32), oriented=True))  # positive: clockwise
    if len(hull) != 4 or abs(signed_area) < 25.0 or min(size) <= 0.0:
        raise CodedError("bad_rectangle")
    # seen from above and going clockwise, the second side goes to the map's negative y
    width = size[0]
    depth = -math.copysign(size[1], signed_area)
    points = np.array([[0.0, 0.0], [width, 0.0], [width, depth], [0.0, depth]])
    views = [_view_from_above(CameraModel.ideal(*image, factor * image[0]), pixels, points) for factor in _FOCALS]
    errors = np.array([error for _, error in views])
    costs = 4 * (errors / _CLICK_SIGMA) ** 2 + (np.log(_FOCALS / _USUAL_FOCAL) / _FOCAL_SIGMA) ** 2
    view, error = views[int(np.argmin(costs))]
    if not error < _MAX_CORNER_ERROR * math.hypot(*image):
        raise CodedError("bad_rectangle")
    return view


def _view_from_above(camera: CameraModel, pixels: np.ndarray, points: np.ndarray) -> Tuple[PosedCamera, float]:
    """Returns the best view of points (4, 2) on the floor from above it, and their rms error in the image [px]."""
    best_pose = np.eye(4)
    least_error = math.inf
    for T in planar_poses(camera.pixels_to_rays(pixels), points):
        error = float(np.sqrt(np.mean(np.sum((project(camera, T, points) - pixels) ** 2, axis=1))))
        if T[2, 3] > 0.0 and error < least_error:
            best_pose, least_error = T, error
    return PosedCamera(camera, best_pose), least_error


def click_uncertainty(
    pixels: np.ndarray, size: Tuple[float, float], image: Tuple[int, int], places: np.ndarray
) -> float:
    """Returns the rms error [m] of a spot at the worst of `places` (N, 2) [px] that is due to inexact clicks."""
    random = np.random.default_rng(1)
    draws = []
    for _ in range(_CLICK_DRAWS):
        clicks = np.asarray(pixels, float) + random.normal(0.0, _CLICK_SIGMA, (4, 2))
        try:
            view = estimate_camera_from_rectangle(clicks, size, image)
        except CodedError:
            return math.inf
        draws.append(project_to_floor(view.camera, view.T_map_camera, places)[:, :2])
    positions = np.array(draws)
    with np.errstate(invalid="ignore"):
        squared_errors = np.sum((positions - np.nanmean(positions, axis=0)) ** 2, axis=2)
        return float(np.nanmax(np.sqrt(np.mean(squared_errors, axis=0))))
