"""Starts the nodes of a launch file, as roslaunch would, within this process."""

from __future__ import annotations

import ast
import importlib
from functools import lru_cache
from pathlib import Path
from typing import Any, Callable, Collection, Mapping, Tuple

import rospkg

from vb_sim.in_process_ros.rospy_stand_in import Graph, Node

_STATE = "/folder-of-this-run"


@lru_cache(maxsize=32)
def read_launch(path: str, arguments: Tuple[str, ...]) -> Any:
    """Reads a launch file as roslaunch does, with its `nodes` and `params`; arguments as "name:=value"."""
    from roslaunch.config import ROSLaunchConfig
    from roslaunch.xmlloader import XmlLoader

    config = ROSLaunchConfig()
    XmlLoader(resolve_anon=False).load(path, config, argv=list(arguments), verbose=False)
    return config


def import_nodes(path: Path, arguments: Mapping[str, str], without: Collection[str] = ()) -> None:
    """Imports the modules of a launch file's nodes. It must be called before anything is replaced.

    A module that is imported during a run would keep that run's replacements for good, and the next run in this process
    would call those of a run that is over.
    """
    for launched in read_launch(str(path), _as_words(arguments)).nodes:
        if launched.type not in without:
            source = _script_path(launched.package, launched.type).read_text(encoding="utf-8")
            for statement in ast.walk(ast.parse(source)):
                if isinstance(statement, ast.ImportFrom) and statement.module:
                    importlib.import_module(statement.module)


def start_launch(
    graph: Graph,
    path: Path,
    arguments: Mapping[str, str],
    without: Collection[str] = (),
    instead: Mapping[str, Callable[[], Any]] = {},
) -> None:
    """Starts the nodes of a launch file.

    Args:
        arguments: the launch file's arguments; "state" is this run's folder.
        without: the types of nodes to omit.
        instead: by type of node, a function that is called instead of the node's script, under the node's name.
    """
    config = read_launch(str(path), _as_words(arguments))
    for key, parameter in config.params.items():
        value = parameter.value
        if isinstance(value, str):
            value = value.replace(_STATE, arguments.get("state", ""))
        graph.parameters.set_param(key, value)
    for launched in config.nodes:
        if launched.type not in without:
            node = Node(f"{launched.namespace}{launched.name}", dict(launched.remap_args))
            graph.start(node, instead.get(launched.type) or _script(launched.package, launched.type))


def _as_words(arguments: Mapping[str, str]) -> Tuple[str, ...]:
    # a placeholder stands for each run's own folder, with which the file would have to be read again for each run
    values = {**arguments, "state": _STATE} if "state" in arguments else arguments
    return tuple(f"{name}:={value}" for name, value in sorted(values.items()))


@lru_cache(maxsize=None)
def _script_path(package: str, kind: str) -> Path:
    return Path(rospkg.RosPack().get_path(package)) / "scripts" / kind


def _script(package: str, kind: str) -> Callable[[], Any]:
    path = _script_path(package, kind)
    code = compile(path.read_text(encoding="utf-8"), str(path), "exec")
    # runpy would replace this process's __main__, so that a process of multiprocessing would start the node again
    return lambda: exec(code, {"__name__": "__main__", "__file__": str(path)})
