"""Reads a node's private parameters once, into a checked dataclass."""

from __future__ import annotations

from typing import Type, TypeVar

import rospy

from vb_core.parameters import Parameters

P = TypeVar("P", bound=Parameters)


def read(cls: Type[P], namespace: str = "~") -> P:
    """Reads a parameter class from the parameter server and logs what differs from the defaults.

    Args:
        namespace: "~" for the node's private parameters, or for instance "~stationary".

    Raises:
        ParameterError: names the full key that is unknown, of a wrong type or out of range.
    """
    full_namespace = rospy.resolve_name(namespace).rstrip("/")
    params = cls.from_mapping(rospy.get_param(full_namespace, {}), full_namespace)
    if params.describe():  # defaults are not logged: those of twenty nodes would bury the warnings
        rospy.loginfo("%s: %s", full_namespace, params.describe())
    return params
