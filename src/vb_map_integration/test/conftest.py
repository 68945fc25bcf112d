"""Fixtures for unit tests of stored borders."""

import pytest

from integrators import GRID, integrator


@pytest.fixture
def restart(tmp_path):
    """Returns a function that closes the integrator before, and starts one on the files in tmp_path."""
    running = []

    def start(grid=GRID, **params):
        while running:
            running.pop().close()
        running.append(integrator(tmp_path, grid, **params))
        return running[-1]

    yield start
    for keeper in running:
        keeper.close()
