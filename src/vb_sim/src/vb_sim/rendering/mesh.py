"""Represents the world's solid objects by flat faces, and draws them into a depth buffer.

Colours are rgb. A depth buffer contains inverse depths along the optical axis [1/m]; 0 where nothing is drawn.
"""

from __future__ import annotations

import math
from typing import Any, List, Sequence, Tuple

import cv2
import numpy as np

from vb_core.camera_model import CameraModel
from vb_core.geometry import invert_transform, transform_points
from vb_sim.floor_plan import wall_outline
from vb_sim.world import Furniture, World

Face = Tuple[Any, Sequence[float]]  # corners and colour
_NEAR = 0.03
# light from above and slightly from the side, so that a box's sides differ in brightness
_LIGHT = np.array([0.30, -0.45, 0.84])
_AMBIENT, _DIRECT = 0.58, 0.46
_SHIFT = 4


class Mesh:
    """Flat convex faces in the map frame: their normals (N, 3), their colours (N, 3), and all corners (M, 3) [m].

    Args:
        faces: at least one; corners (K, 3) [m] of each face, counter-clockwise seen from outside, and its colour.
    """

    def __init__(self, faces: Sequence[Face]) -> None:
        corners = [np.asarray(outline, dtype=float) for outline, _ in faces]
        normals = []
        colors = []
        for outline, (_, color) in zip(corners, faces):
            normal = np.cross(outline[1] - outline[0], outline[2] - outline[0])
            normal /= float(np.linalg.norm(normal))
            brightness = _AMBIENT + _DIRECT * max(0.0, float(normal @ _LIGHT))
            normals.append(normal)
            colors.append(np.clip(np.array(color, dtype=float) * brightness, 0, 255))
        self.normals = np.array(normals)
        self.colors = np.array(colors)
        self.corners = np.concatenate(corners)
        # index of each face's first corner, and the number of all corners
        self.starts = np.cumsum([0, *map(len, corners)])


def prism(
    outline: np.ndarray, low: float, high: float, color: Sequence[float], bands: Sequence[Tuple[float, float]] = ()
) -> List[Face]:
    """Builds the faces of an upright prism over a convex outline (N, 2), counter-clockwise, from `low` to `high` [m].

    Args:
        bands: (upper height [m], brightness) of strips of its sides, from the bottom up; above, the brightness is 1.
    """
    outline = np.asarray(outline, dtype=float)
    color = np.array(color, dtype=float)
    strips = [(top, brightness) for top, brightness in bands if low < top < high] + [(high, 1.0)]
    faces: List[Face] = []
    for a, b in zip(outline, np.roll(outline, -1, axis=0)):
        bottom = low
        for top, brightness in strips:
            corners = [(*a, bottom), (*b, bottom), (*b, top), (*a, top)]
            faces.append((corners, color * brightness))
            bottom = top
    faces.append((np.column_stack([outline, np.full(len(outline), high)]), color))
    if low > 0:
        faces.append((np.column_stack([outline, np.full(len(outline), low)])[::-1], color * 0.7))
    return faces


def world_mesh(world: World) -> Mesh:
    """Builds the mesh of a world's walls and furniture."""
    width, height = world.room.size
    t, top = world.room.wall_thickness, world.room.wall_height
    faces: List[Face] = []
    skirting_board = [(0.07, 0.72), (0.08, 0.5)]
    for x0, y0, x1, y1 in (
        (-t, -t, width + t, 0),
        (-t, height, width + t, height + t),
        (-t, 0, 0, height),
        (width, 0, width + t, height),
    ):
        outline = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], dtype=float)
        faces += prism(outline, 0.0, top, (214, 209, 200), skirting_board)
    for wall in world.walls:
        faces += prism(wall_outline(wall), 0.0, wall.height, wall.color, [(0.04, 0.8)])
    for thing in world.furniture:
        faces += _furniture_faces(thing)
    return Mesh(faces)


def _furniture_faces(thing: Furniture) -> List[Face]:
    if thing.kind == "cylinder":
        return prism(thing.footprint(), 0.0, thing.height, thing.color)
    if thing.kind == "box":
        # boxes are darker near the floor
        bands = [(0.06 * thing.height, 0.55), (0.3 * thing.height, 0.86), (0.65 * thing.height, 0.94)]
        return prism(thing.footprint(), 0.0, thing.height, thing.color, bands)
    board_bottom = thing.height - min(0.04, thing.height / 4)
    faces: List[Face] = []
    for leg in thing.contact_outlines():
        faces += prism(leg, 0.0, board_bottom, 0.8 * np.array(thing.color))
    return faces + prism(thing.footprint(), board_bottom, thing.height, thing.color)


class RayGrid:
    """The viewing rays of all pixels of a camera, (x, y, 1) in the optical frame.

    Without distortion, x is (1, W) and y is (H, 1), otherwise both are (H, W); float32.
    """

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self.distorted = camera.is_distorted
        if self.distorted:
            self.x, self.y = self._distorted_rays(camera)
        else:
            matrix = camera.matrix
            x = (np.arange(camera.width) - matrix[0, 2]) / matrix[0, 0]
            y = (np.arange(camera.height) - matrix[1, 2]) / matrix[1, 1]
            self.x = x.astype(np.float32)[None, :]
            self.y = y.astype(np.float32)[:, None]
        limits = (self.x.min(), self.x.max(), self.y.min(), self.y.max())
        self.limits = tuple(map(float, limits))

    @staticmethod
    def _distorted_rays(camera: CameraModel) -> Tuple[np.ndarray, np.ndarray]:
        # exact in the middle of each square of 8 x 8 pixels; linear interpolation between these is accurate enough
        step = 8
        columns = math.ceil(camera.width / step) + 2  # one more square at each edge
        rows = math.ceil(camera.height / step) + 2
        middle = (step - 1) / 2 - step  # of the first square
        u, v = np.meshgrid(middle + step * np.arange(columns), middle + step * np.arange(rows))
        rays = camera.pixels_to_rays(np.column_stack([u.ravel(), v.ravel()]))
        in_image = np.s_[step : step + camera.height, step : step + camera.width]
        grids = []
        for axis in range(2):
            coarse = rays[:, axis].reshape(rows, columns).astype(np.float32)
            fine = cv2.resize(coarse, (columns * step, rows * step), interpolation=cv2.INTER_LINEAR)
            grids.append(np.ascontiguousarray(fine[in_image]))
        return grids[0], grids[1]

    def dot_rays(
        self, a: float, b: float, c: float, rows: slice = slice(None), columns: slice = slice(None)
    ) -> np.ndarray:
        """Computes the dot products of (a, b, c) and the rays (x, y, 1) of a part of the image, (h, w) float32."""
        if self.distorted:
            x, y = self.x[rows, columns], self.y[rows, columns]
        else:
            x, y = self.x[:, columns], self.y[rows]
        return np.float32(a) * x + (np.float32(b) * y + np.float32(c))


class DepthBuffer:
    """The nearest surface in each pixel.

    Attributes:
        inverse: (H, W) float32 [1/m] inverse depth along the optical axis, 0 for the floor.
        ids: (H, W) uint8, index into `colors` and `normals`, 0 for the floor.
        colors: (256, 3) uint8 rgb.
    """

    def __init__(self, grid: RayGrid) -> None:
        self.grid = grid
        size = (grid.camera.height, grid.camera.width)
        self.inverse = np.zeros(size, np.float32)
        self.ids = np.zeros(size, np.uint8)
        self.normals = np.zeros((256, 3), np.float32)
        self.colors = np.zeros((256, 3), np.uint8)
        self._count = 0

    def clear(self) -> None:
        """Empties the buffer."""
        self.inverse.fill(0)
        self.ids.fill(0)
        self._count = 0

    def draw_mesh(self, mesh: Mesh, T_map_optical: np.ndarray, gain: float = 1.0) -> None:
        """Draws the faces of a mesh that the camera sees, with their colours multiplied by a gain."""
        T = invert_transform(T_map_optical)
        corners = transform_points(T, mesh.corners)
        normals = mesh.normals @ T[:3, :3].T
        starts = mesh.starts[:-1]
        offsets = np.einsum("ij,ij->i", normals, corners[starts])
        distances = self._distances_inside(corners)
        faces_camera = offsets < -1e-9
        is_partly_inside = (np.maximum.reduceat(distances, starts, axis=1) > 0).all(axis=0)
        is_inside = np.minimum.reduceat(distances, starts, axis=1) >= 0
        visible = np.flatnonzero(faces_camera & is_partly_inside)
        free_ids = 255 - self._count
        if len(visible) > free_ids:
            nearest_depths = np.minimum.reduceat(corners[:, 2], starts)
            visible = visible[np.argsort(nearest_depths[visible])][:free_ids]
        # the near plane is the first; without distortion it is enough, because drawing clips faces to the image
        planes = 5 if self.grid.distorted else 1
        for index in visible:
            face = corners[mesh.starts[index] : mesh.starts[index + 1]]
            for plane in np.flatnonzero(~is_inside[:planes, index]):
                face = self._clip(face, plane)
                if len(face) < 3:
                    break
            else:
                plane_of_face = normals[index] / offsets[index]
                self._fill(self._outline(face), plane_of_face, mesh.colors[index] * gain, normals[index])

    def draw_flat(self, outline_px: np.ndarray, depth: float, color: np.ndarray, normal: np.ndarray) -> None:
        """Draws the convex hull of points (N, 2) [px] as a face at one depth [m]."""
        if self._count < 255:
            hull = cv2.convexHull(np.asarray(outline_px, dtype=np.float32))[:, 0]
            self._fill(hull, np.array([0.0, 0.0, 1.0 / depth]), color, normal)

    def _distances_inside(self, points: np.ndarray) -> np.ndarray:
        """Returns the distances (5, N) of points (N, 3) [m] from the near plane and the view's sides, positive inside.

        Distances from the sides are scaled. Points are in the optical frame.
        """
        x0, x1, y0, y1 = self.grid.limits
        x, y, z = points.T
        sides = [x - x0 * z, x1 * z - x, y - y0 * z, y1 * z - y]
        return np.stack([z - _NEAR, *sides])

    def _clip(self, face: np.ndarray, plane: int) -> np.ndarray:
        """Returns the part of a face (N, 3) [m] inside one plane of the view (Sutherland and Hodgman)."""
        distances = self._distances_inside(face)[plane]
        clipped = []
        for i in range(len(face)):
            j = (i + 1) % len(face)
            if distances[i] >= 0:
                clipped.append(face[i])
            if (distances[i] >= 0) != (distances[j] >= 0):
                share = distances[i] / (distances[i] - distances[j])
                clipped.append(face[i] + share * (face[j] - face[i]))
        return np.array(clipped).reshape(-1, 3)

    def _outline(self, face: np.ndarray) -> np.ndarray:
        """Projects a face (N, 3) [m] in the optical frame to an outline (M, 2) [px]."""
        if self.grid.distorted:
            # samples the edges, because the lens bends them
            shares = np.linspace(0, 1, 12, endpoint=False)[None, :, None]
            starts = face[:, None, :]
            ends = np.roll(face, -1, axis=0)[:, None, :]
            samples = starts * (1 - shares) + ends * shares
            return self.grid.camera.project(samples.reshape(-1, 3))
        matrix = self.grid.camera.matrix
        focal = (matrix[0, 0], matrix[1, 1])
        center = (matrix[0, 2], matrix[1, 2])
        return face[:, :2] / face[:, 2:] * focal + center

    def _fill(self, outline: np.ndarray, plane: np.ndarray, color: np.ndarray, normal: np.ndarray) -> None:
        """Draws a face where it is the nearest surface so far.

        Args:
            outline: (N, 2) [px].
            plane: (3,) (a, b, c) [1/m]: a x + b y + c is the inverse depth of the face along a ray (x, y, 1).
        """
        height, width = self.ids.shape
        (min_x, min_y), (max_x, max_y) = outline.min(axis=0), outline.max(axis=0)
        left, top = max(math.floor(min_x), 0), max(math.floor(min_y), 0)
        right, bottom = min(math.ceil(max_x) + 1, width), min(math.ceil(max_y) + 1, height)
        if right <= left or bottom <= top:
            return
        mask = np.zeros((bottom - top, right - left), np.uint8)
        points = np.round((outline - (left, top)) * (1 << _SHIFT)).astype(np.int32)
        if self.grid.distorted:
            cv2.fillPoly(mask, [points], 1, cv2.LINE_8, _SHIFT)
        else:
            cv2.fillConvexPoly(mask, points, 1, cv2.LINE_8, _SHIFT)
        self._count += 1
        self.colors[self._count] = np.minimum(np.maximum(color, 0), 255)
        self.normals[self._count] = normal
        rows, columns = slice(top, bottom), slice(left, right)
        inverse = self.inverse[rows, columns]
        candidate = self.grid.dot_rays(*plane, rows, columns)
        nearer = mask.astype(bool) & (candidate > inverse)
        np.copyto(inverse, candidate, where=nearer)
        self.ids[rows, columns][nearer] = self._count

    def paint(self, image: np.ndarray) -> None:
        """Paints the drawn objects into the image (H, W, 3) of the floor, in place."""
        left, top, width, height = cv2.boundingRect(self.ids)
        if width == 0:
            return
        part = (slice(top, top + height), slice(left, left + width))
        ids = self.ids[part]
        cv2.copyTo(cv2.applyColorMap(ids, self.colors[:, None]), ids, image[part])
