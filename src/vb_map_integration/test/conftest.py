"""What unit tests of stored borders share."""

import pytest

from integrators import GRID, integrator


@pytest.fixture
def restart(tmp_path):
    """Starts an integrator on the files in tmp_path, after the end of the one before."""
    running = []

    def start(grid=GRID, **params):
        while running:
            running.pop().close()
        running.append(integrator(tmp_path, grid, **params))
        return running[-1]

    yield start
    for keeper in running:
        keeper.close()
