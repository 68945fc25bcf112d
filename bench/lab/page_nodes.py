"""Runs the nodes that the page needs with their own ROS master; for stop_under_attack.py and camera_load.py."""

from __future__ import annotations

import os
import socket
import subprocess
import tempfile
import xmlrpc.client
from contextlib import ExitStack
from pathlib import Path
from typing import Tuple

import psutil
import rosgraph
import rospy

from bench.harness import TOP
from vb_core import names
from vb_core.child_processes import free_port, start_roslaunch
from vb_testing import wait_until

# as in docs/how-to/use-the-page.md
CERTIFICATE = (
    "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=lab"
    " -keyout page.key -out page.crt"
)


def start_page(stack: ExitStack, network: bool = False) -> Tuple[int, Path]:
    """Starts roscore and nodes, with codes and https if `network`; returns (page's port, state folder)."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="bench_page_")))
    master, port = free_port(), free_port()
    os.environ.update({"ROS_MASTER_URI": f"http://127.0.0.1:{master}", "ROS_LOG_DIR": str(folder / "log")})
    address = "0.0.0.0" if network else "127.0.0.1"
    if network:
        subprocess.run(CERTIFICATE.split(), cwd=str(folder), check=True, stderr=subprocess.DEVNULL)
    launch = TOP / "bench" / "lab" / "page.launch"
    nodes = start_roslaunch([launch], folder / "out.txt", master, state=folder, page_port=port, address=address)
    stack.callback(nodes.stop)
    wait_until(rosgraph.is_master_online, "the master")
    rospy.init_node("bench_page", anonymous=True, disable_signals=True, log_level=rospy.ERROR)
    wait_until(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, "the page")
    rospy.wait_for_service(names.COMMAND, 60)
    return port, folder


def node_process(name: str = "/page") -> psutil.Process:
    """Returns a node's process."""
    wait_until(lambda: rospy.get_master().lookupNode(name)[0] == 1, f"{name} at the master")
    uri = rospy.get_master().lookupNode(name)[2]
    return psutil.Process(xmlrpc.client.ServerProxy(uri).getPid("/bench")[2])
