"""Delays the connections of a process's subscribers: some by nothing, some by LATE_CONNECTIONS seconds, some between.

Python runs a module of this name at its start if it is on the path: `scripts/test --late SECONDS` puts it there. What a
test or a node then misses, it may also miss on a busy computer.
"""

import importlib.abc
import importlib.machinery
import os
import random
import sys
import time

LATEST = float(os.environ.get("LATE_CONNECTIONS", "0"))
MODULE = "rospy.impl.registration"


class LateConnections(importlib.abc.MetaPathFinder):
    """Finds the module that makes rospy's connections, and delays them."""

    def find_spec(self, fullname, path, target=None):
        if fullname != MODULE:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path)
        load = spec.loader.exec_module

        def load_late(module):
            load(module)
            connect = module.RegManager._connect_topic_thread

            def connect_late(manager, topic, uri):
                if topic not in ("/clock", "/rosout"):
                    time.sleep(LATEST * min(1.0, max(0.0, random.uniform(-1.0, 2.0))))
                connect(manager, topic, uri)

            module.RegManager._connect_topic_thread = connect_late

        spec.loader.exec_module = load_late
        return spec


if LATEST > 0.0:
    sys.meta_path.insert(0, LateConnections())
