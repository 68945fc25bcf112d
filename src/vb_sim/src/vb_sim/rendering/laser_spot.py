"""Renders the image of a laser spot on the floor.

The beam's footprint is an ellipse of light, many times brighter than the floor. Lens and filter blur it, motion during
the exposure smears it, and some of its light is scattered into a halo. The sensor saturates in the spot's core. The
core is white, because even the light that leaks through the filters of the other colours saturates there; the halo
around it is coloured. The spot's size follows from power, exposure and distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.geometry import invert_transform, transform_points
from vb_sim.model_params import Optics
from vb_sim.world import Point2

_MAX_PX = 56


@dataclass(frozen=True)
class SpotImage:
    """The light of a spot, in a patch of an image."""

    column: int  # [px] of the patch's first pixel
    row: int
    center: Tuple[float, float]  # (u, v) [px] of the spot in the middle of the exposure
    light: np.ndarray  # (h, w) float32 [grey levels] on a white floor, before any colour filter

    @property
    def pixel(self) -> Tuple[int, int]:
        """Column and row of the pixel at the spot's centre."""
        return int(round(self.center[0])), int(round(self.center[1]))

    @property
    def area(self) -> Tuple[slice, slice]:
        """Rows and columns of the patch."""
        height, width = self.light.shape
        return slice(self.row, self.row + height), slice(self.column, self.column + width)


def render_spot(
    point: Point2,
    velocity: Point2,
    source: Optional[np.ndarray],
    camera: CameraModel,
    T_map_optical: np.ndarray,
    optics: Optics,
) -> Optional[SpotImage]:
    """Renders the light of a spot. Returns None if it is out of view.

    Args:
        point: [m] position of the spot, map frame.
        velocity: [m/s] of the spot.
        source: (3,) [m] position of the pointer; None if it is straight above the spot.
    """
    projection = _project(point, velocity, camera, T_map_optical, optics)
    if projection is None:
        return None
    center, jacobian, smear = projection
    pixels_per_m2 = abs(_determinant(jacobian))
    if pixels_per_m2 < 1e-6:
        return None
    # a pixel integrates light over its area, which adds a variance of 1/12 px^2
    blur = (optics.psf_sigma_px**2 + 1.0 / 12.0) * np.eye(2)
    covariance = jacobian @ _footprint_covariance(point, source, optics) @ jacobian.T + blur
    # laser power relative to ambient light, as if all its light fell into one pixel
    total = optics.laser_power_mw * 1e-3 * pixels_per_m2 / optics.ambient_w_m2
    total *= optics.white_level * optics.exposure_gain
    radius = _light_radius(total, covariance, optics) + float(np.linalg.norm(smear)) / 2.0
    half = min(_MAX_PX, math.ceil(radius))
    column, row = (int(value) for value in np.rint(center))
    left, right = max(column - half, 0), min(column + half + 1, camera.width)
    top, bottom = max(row - half, 0), min(row + half + 1, camera.height)
    if right <= left or bottom <= top:
        return None
    u = np.arange(left, right, dtype=np.float32)[None, :] - np.float32(center[0])
    v = np.arange(top, bottom, dtype=np.float32)[:, None] - np.float32(center[1])
    light = _spread_light(u, v, (1.0 - optics.halo_share) * total, covariance, smear)
    distance = np.sqrt(u * u + v * v)
    halo = np.exp(-distance / np.float32(optics.halo_scale_px))
    light += np.float32(_halo_peak(total, optics)) * halo
    return SpotImage(left, top, (float(center[0]), float(center[1])), light)


def add_spot(
    image: np.ndarray, spot: SpotImage, weights: np.ndarray, encoding: str, full_well_e: float, rng: np.random.Generator
) -> None:
    """Adds a spot's light to an image in place.

    Args:
        weights: (3,) shares of the light that pass the red, green and blue filters.
        full_well_e: [electrons] at 255, which determines the photon noise of the light.
    """
    light = apply_color_filters(spot.light, weights, encoding, spot.column, spot.row)
    sigma = np.sqrt(np.minimum(light, 255.0) * np.float32(255.0 / full_well_e))
    light += sigma * rng.standard_normal(light.shape, dtype=np.float32)
    part = image[spot.area]
    part[...] = np.clip(part + light + 0.5, 0, 255)


def apply_color_filters(values: np.ndarray, weights: np.ndarray, encoding: str, column: int, row: int) -> np.ndarray:
    """Returns the light behind a sensor's colour filters, (h, w) or (h, w, 3), for light (h, w) before them.

    Args:
        weights: (3,) shares for red, green, blue.
        column, row: position of the light's first pixel in the image, on which a Bayer pattern's phase depends.
    """
    red, green, blue = (np.float32(weight) for weight in weights)
    if encoding == "rgb8":
        return values[..., None] * np.array([red, green, blue])
    if encoding == "bgr8":
        return values[..., None] * np.array([blue, green, red])
    if encoding == "mono8":
        return values * np.float32(0.299 * red + 0.587 * green + 0.114 * blue)
    result = values * green
    red_pixels = np.s_[row % 2 :: 2, column % 2 :: 2]
    blue_pixels = np.s_[1 - row % 2 :: 2, 1 - column % 2 :: 2]
    result[red_pixels] = values[red_pixels] * red
    result[blue_pixels] = values[blue_pixels] * blue
    return result


def _project(
    point: Point2, velocity: Point2, camera: CameraModel, T_map_optical: np.ndarray, optics: Optics
) -> Optional[Tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Returns the spot's centre (2,) [px], the Jacobian there (2, 2) [px/m], and the spot's motion blur (2,) [px]."""
    step = 1e-3  # [m]
    border = 30.0  # [px] round the image
    half_exposure = optics.exposure_ms * 1e-3 / 2.0
    x, y = point
    dx, dy = velocity[0] * half_exposure, velocity[1] * half_exposure
    at_spot = [(x, y, 0), (x + step, y, 0), (x, y + step, 0)]
    at_ends = [(x - dx, y - dy, 0), (x + dx, y + dy, 0)]
    in_camera = transform_points(invert_transform(T_map_optical), np.array(at_spot + at_ends))
    if (in_camera[:, 2] < 0.05).any():
        return None
    center, beside_x, beside_y, first, last = camera.project(in_camera)
    size = np.array([camera.width, camera.height])
    if (center <= -border).any() or (center >= size + border).any():
        return None
    jacobian = np.column_stack([beside_x - center, beside_y - center]) / step
    return center, jacobian, last - first


def _spread_light(u: np.ndarray, v: np.ndarray, total: float, covariance: np.ndarray, smear: np.ndarray) -> np.ndarray:
    """Returns the light (h, w) of an ellipse that moves by `smear` (2,) [px], at offsets u (1, w) and v (h, 1) [px].

    It is the mean of Gaussians exp(-d^T C^-1 d / 2) at several instants of the exposure, with covariance C.
    """
    determinant = _determinant(covariance)
    # the elements of C^-1
    uu = np.float32(covariance[1, 1] / determinant)
    uv = np.float32(-covariance[0, 1] / determinant)
    vv = np.float32(covariance[0, 0] / determinant)
    length = float(np.linalg.norm(smear))
    count = 1 if length < 0.5 else min(11, 2 + int(length / 0.8))
    instants = ((np.arange(count) + 0.5) / count - 0.5)[:, None, None]
    du = u - (instants * smear[0]).astype(np.float32)
    dv = v - (instants * smear[1]).astype(np.float32)
    mixed_term = (np.float32(2) * uv * du) * dv
    squared_distance = uu * du * du + mixed_term + vv * dv * dv
    light = np.exp(np.float32(-0.5) * squared_distance).sum(axis=0)
    light *= np.float32(_core_peak(total, covariance) / count)
    return light


def _core_peak(total: float, covariance: np.ndarray) -> float:
    """Returns the light [grey levels] in the centre of an ellipse with a covariance (2, 2) [px^2]."""
    return total / (2.0 * math.pi * math.sqrt(_determinant(covariance)))


def _halo_peak(total: float, optics: Optics) -> float:
    """Returns the halo's light [grey levels] at its centre, from which it decays exponentially."""
    return optics.halo_share * total / (2.0 * math.pi * optics.halo_scale_px**2)


def _determinant(matrix: np.ndarray) -> float:
    return float(matrix[0, 0] * matrix[1, 1] - matrix[0, 1] * matrix[1, 0])


def _footprint_covariance(point: Point2, source: Optional[np.ndarray], optics: Optics) -> np.ndarray:
    """Computes the covariance (2, 2) [m^2] of the light on the floor, an ellipse if the beam is oblique."""
    distance = 1.5
    covariance = np.eye(2)
    if source is not None:
        along = np.array(point) - source[:2]
        horizontal = float(np.linalg.norm(along))
        distance = math.hypot(horizontal, source[2])
        if horizontal > 1e-6:
            along /= horizontal
            stretch = min(distance / max(float(source[2]), 0.05), 6.0)
            covariance = np.eye(2) + (stretch**2 - 1.0) * np.outer(along, along)
    diameter = optics.beam_diameter_mm * 1e-3 + optics.divergence_mrad * 1e-3 * distance
    return covariance * (diameter / 4.0) ** 2


def _light_radius(total: float, covariance: np.ndarray, optics: Optics) -> float:
    """Computes the radius [px] beyond which the spot adds less than half a grey level."""
    half_trace = 0.5 * float(covariance[0, 0] + covariance[1, 1])
    squared_difference = half_trace**2 - _determinant(covariance)
    largest_eigenvalue = half_trace + math.sqrt(max(0.0, squared_difference))
    peak = max(1.0, _core_peak(total, covariance))
    core_radius = math.sqrt(largest_eigenvalue) * math.sqrt(2.0 * math.log(2.0 * peak + 1.0))
    halo_radius = optics.halo_scale_px * math.log(max(1.0, 2.0 * _halo_peak(total, optics)))
    return max(core_radius, halo_radius) + 2.0
