"""A snapshot of the ROS graph: what nodes publish, subscribe to and serve, and which could command a base. No ROS."""

from __future__ import annotations

from typing import Iterable, List, Mapping, Sequence, Set, Tuple

_Entries = Iterable[Tuple[str, Sequence[str]]]


class NodeGraph:
    """The ROS graph as a master knows it. `vb_core.ros.master.read_graph` reads it.

    Args:
        published, subscribed, services: pairs (name, nodes) of topics or services.
        types: message types by topic.

    Attributes:
        publishers, subscribers, services: nodes by the name of the topic or service.
        types: message types by topic.
    """

    def __init__(
        self, published: _Entries, subscribed: _Entries, services: _Entries = (), types: Mapping[str, str] = {}
    ) -> None:
        self.publishers = dict(published)
        self.subscribers = dict(subscribed)
        self.services = dict(services)
        self.types = types

    @property
    def nodes(self) -> Set[str]:
        """All nodes."""
        groups = (self.publishers, self.subscribers, self.services)
        return {node for by_name in groups for nodes in by_name.values() for node in nodes}

    def subscriptions(self, node: str, kind: str) -> List[str]:
        """Returns the topics of this type that a node subscribes to."""
        return self._topics_of(node, kind, self.subscribers)

    def publications(self, node: str, kind: str) -> List[str]:
        """Returns the topics of this type that a node publishes."""
        return self._topics_of(node, kind, self.publishers)

    def _topics_of(self, node: str, kind: str, nodes_by_topic: Mapping[str, Sequence[str]]) -> List[str]:
        of_node = [topic for topic, nodes in nodes_by_topic.items() if node in nodes]
        return [topic for topic in of_node if self.types.get(topic) == kind]

    def find_other_commanders(self, driver: str, topic: str, output: str) -> Tuple[Set[str], Set[str]]:
        """Finds the nodes that could command the base past its driver, which should be the only way to its wheels.

        Every registered publisher counts, even a silent one: it may drive at any time, and behind a mux the driver
        cannot hear other nodes at all.

        Args:
            driver: name of the driver's node.
            topic: the topic on which the driver publishes its commands.
            output: the topic on which a mux commands the base; "": the base listens to `topic` itself.

        Returns:
            The nodes, including those that publish velocities to another input of a mux; and the muxes.
        """

        def commanders(name: str) -> Set[str]:
            is_velocity = self.types.get(name, "").startswith("geometry_msgs/Twist")
            return set(self.publishers.get(name, ())) if is_velocity else set()

        muxes = commanders(output) & set(self.subscribers.get(topic, ()))
        others = commanders(topic) | (commanders(output) - muxes)
        for name, nodes in self.subscribers.items():
            if name != topic and not muxes.isdisjoint(nodes):
                others |= commanders(name) - muxes
        return others - {driver}, muxes

    def has_subscriber(self, driver: str, topic: str) -> bool:
        """Returns whether any other node subscribes to the driver's commands."""
        return bool(set(self.subscribers.get(topic, ())) - {driver})
