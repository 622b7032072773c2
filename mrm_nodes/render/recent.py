"""A cache for what lies on the GPU: bounded, and what leaves it is released."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

K = TypeVar("K")
V = TypeVar("V")


class Recent(Generic[K, V]):
    """The `limit` most recently used values; one that has to make room is released."""

    def __init__(self, limit: int, release: Callable[[V], None]) -> None:
        self._limit, self._release = limit, release
        self._values: OrderedDict[K, V] = OrderedDict()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """Return the value of a key, made now if it is not there."""
        if key not in self._values:
            made = make()
            while len(self._values) >= self._limit:
                self._release(self._values.popitem(last=False)[1])
            self._values[key] = made
        self._values.move_to_end(key)
        return self._values[key]

    def __iter__(self) -> Iterator[V]:
        return iter(self._values.values())

    def clear(self) -> None:
        """Release every value."""
        while self._values:
            self._release(self._values.popitem()[1])
