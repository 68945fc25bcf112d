"""Chooses the drawing order that suits a robot that follows the spot."""

from __future__ import annotations

from typing import List

import numpy as np

from vb_core import geometry

FOLLOWING_DISTANCE = 1.0  # [m] the distance from the spot to which the robot drives
STEP = 0.05  # [m]


def list_orders(border: np.ndarray, closed: bool) -> List[np.ndarray]:
    """Lists every order (N, 2) [m] of drawing a border (N, 2) [m]: from either end, or around from each corner."""
    if not closed:
        return [border, border[::-1]]
    turned = [np.roll(border, -shift, axis=0) for shift in range(len(border))]
    return turned + [np.vstack([order[:1], order[:0:-1]]) for order in turned]


def simulate_follower(spots: np.ndarray, robot: np.ndarray) -> np.ndarray:
    """Simulates how near, (N,) [m], the spot at its places (N, 2) comes to a robot from (2,) [m] that drives up to it."""
    place = np.asarray(robot, dtype=float)
    distances = []
    for spot in spots:
        to_spot = spot - place
        distance = float(np.linalg.norm(to_spot))
        if distance > FOLLOWING_DISTANCE:
            place = place + to_spot / distance * (distance - FOLLOWING_DISTANCE)
        distances.append(min(distance, FOLLOWING_DISTANCE))
    return np.array(distances)


def choose_order(border: np.ndarray, closed: bool, robot: np.ndarray) -> np.ndarray:
    """Chooses the order (N, 2) [m] that keeps the spot in front of the robot; among equals the one that begins nearest.

    A robot follows forwards and sees nothing at its own feet, so the spot should not come towards it.

    Args:
        robot: (2,) [m] where the robot is before it is led to the border's beginning.
    """

    def order_cost(order: np.ndarray) -> float:
        chain = np.vstack([order, order[:1]]) if closed else order
        there = geometry.resample_chain(np.vstack([robot, order[0]]), STEP)
        spots = np.vstack([there, geometry.resample_chain(chain, STEP)])
        nearness = np.maximum(0.8 - simulate_follower(spots, robot)[len(there) :], 0.0).sum() * STEP
        return float(nearness) * 20.0 + float(np.linalg.norm(order[0] - robot))

    return min(list_orders(np.asarray(border, dtype=float), closed), key=order_cost)
