#!/usr/bin/env python3
"""Lives with the stack for simulated days: people draw, nodes die, clocks step, maps change.

    make soak HOURS=24            # simulated hours, as fast as the machine goes
    python3 bench/lab/soak.py --hours 2 --seed 7

Real nodes (point set, interaction, map integrator) run over a roscore of their own; this program is the
clock, the cameras, the people and the trouble. After each event it compares the stack with a ledger of what was
acknowledged, and the map with an independent oracle (shapely). The rows are how often each event and each answer came.

Exit status: 0 if every invariant held; 1 at the first one that did not, which is the last row.
"""

from __future__ import annotations

import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, List

import numpy as np
import shapely
from shapely.geometry import Polygon
from shapely.ops import unary_union

from bench.frame import Table, arguments
from bench.lab.soak_people import People, points_of
from bench.lab.soak_stack import NODES, RESOLUTION, Broken


class Soak(People):
    """One life of a lab."""

    def live(self, hours: float) -> None:
        """Hours of events, each followed by a look at all invariants.

        Raises:
            Broken: with the first invariant that did not hold.
        """
        events = [
            (self.interaction, 0.55),
            (self.edit, 0.20),
            (self.step_clock, 0.06),
            (self.change_floor, 0.09),
            (lambda: self.kill(str(self.rng.choice(NODES))), 0.10),
        ]
        weights = [weight for _, weight in events]
        nights = 0
        # each once, so that no life goes by without a rare fault; then as chance has it
        first = [events[int(number)][0] for number in self.rng.permutation(len(events))]
        while self.lived < 3600.0 * hours:
            event = first.pop() if first else events[int(self.rng.choice(len(events), p=weights))][0]
            event()
            self.check()
            if self.lived // 86400 > nights:
                nights += 1
                self.night()
                self.check()
            # a household of some dozen interactions a day
            self.idle(float(self.rng.exponential(600.0)))

    # ------------------------------------------------------------ invariants
    def check(self) -> None:
        """Checks that nothing acknowledged is lost or moved, and that the map is what the borders say."""
        wanted = self.ledger[self.floor]

        def same() -> bool:
            message = self.newest.get("borders")
            if message is None:
                return False
            found = {border.id: points_of(border) for border in message.borders}
            return set(found) == set(wanted) and all(
                found[key].shape == wanted[key].shape and np.allclose(found[key], wanted[key], atol=1e-9)
                for key in wanted
            )

        try:
            self.wait(same, "the borders that were acknowledged", limit=15.0)
        except Broken:
            message = self.newest.get("borders")
            found = sorted(border.id for border in message.borders) if message is not None else None
            raise Broken(f"borders are {found}, acknowledged were {sorted(wanted)}") from None
        sure_inside, sure_outside = self._oracle(list(wanted.values()))
        self.wait(lambda: self._map_agrees(sure_inside, sure_outside), "a map that agrees with the oracle", limit=15.0)
        self.counts["checked"] += 1

    def _oracle(self, polygons: List[Any]) -> Any:
        """(rows, columns) cells that are surely inside some polygon, and surely outside all; the edge may go either way."""
        rows, columns = np.mgrid[:100, :160]
        centers = shapely.points((columns.ravel() + 0.5) * RESOLUTION, (rows.ravel() + 0.5) * RESOLUTION)
        area = unary_union([Polygon(points).buffer(0) for points in polygons])
        inside = shapely.contains(area.buffer(-1.5 * RESOLUTION), centers).reshape(100, 160)
        outside = ~shapely.intersects(area.buffer(1.5 * RESOLUTION), centers).reshape(100, 160)
        return inside, outside

    def _map_agrees(self, inside: Any, outside: Any) -> bool:
        message = self.newest.get("posterior")
        if message is None:
            return False
        got, physical = np.asarray(message.data).reshape(100, 160), self.maps[self.floor]
        # floor that lies inside of a border but cannot be reached from its seed may stay as it was
        free = physical == 0
        restricted_share = (got[inside & free] == 100).mean() if (inside & free).any() else 1.0
        return bool(
            (got[outside] == physical[outside]).all()
            and (got[~free] == physical[~free]).all()
            and restricted_share > 0.5
        )


def main() -> int:
    parser = arguments(__doc__, seed=1)
    parser.add_argument("--hours", type=float, default=24.0, help="simulated")
    given = parser.parse_args()
    folder, began = Path(tempfile.mkdtemp(prefix="soak_")), time.monotonic()
    soak = Soak(given.seed, folder)
    # also where a shell that starts it in the background has them ignored; a life that is ended early counts as far as
    # it went
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    fault = ""
    try:
        soak.start()
        soak.tell_map()
        soak.settle()
        soak.live(given.hours)
    except KeyboardInterrupt:
        pass
    except Broken as error:
        fault = str(error)
    finally:
        soak.close()
    table, life = Table(given.csv), {"hours": soak.lived / 3600.0, "seed": given.seed}
    for what, count in sorted(soak.counts.items()):
        table.add(**life, what=what, times=count)
    print(f"{soak.lived / 3600:.2f} hours in {(time.monotonic() - began) / 60:.0f} minutes")
    if fault:
        table.add(**life, what=fault, times=1)
        print(f"broken; the logs are in {folder}")
        return 1
    shutil.rmtree(str(folder), ignore_errors=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
