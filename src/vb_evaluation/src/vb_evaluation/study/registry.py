"""Names for classes and functions that a study's configuration may choose."""
from __future__ import annotations

from typing import Callable, Dict, Generic, Iterator, TypeVar

from vb_core.errors import ParameterError

T = TypeVar("T")


class Registry(Generic[T]):
    """Things by name.

    Args:
        what: what they are, for sentences: "method".
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._things: Dict[str, T] = {}

    def register(self, name: str) -> Callable[[T], T]:
        """A decorator that gives its class or function a name; a name that exists is taken over."""

        def keep(thing: T) -> T:
            self._things[name] = thing
            return thing

        return keep

    def get(self, name: str) -> T:
        """The thing of that name; ParameterError with the names there are."""
        if name not in self._things:
            raise ParameterError(self._what, f"'{name}' is unknown; known are {', '.join(self._things)}")
        return self._things[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._things)
