"""Sequences whose items are made when they are asked for, so that a long run is never in memory as a whole."""

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TypeVar, overload

Item = TypeVar("Item")


class ByPlace(Sequence[Item]):
    """A sequence whose item at a place from 0 to its length is `_item(place)`."""

    @abstractmethod
    def _item(self, place: int) -> Item: ...

    @overload
    def __getitem__(self, at: int) -> Item: ...

    @overload
    def __getitem__(self, at: slice) -> Sequence[Item]: ...

    def __getitem__(self, at: int | slice) -> Item | Sequence[Item]:
        if isinstance(at, slice):
            return [self._item(k) for k in range(len(self))[at]]
        return self._item(range(len(self))[at])


class OnDemand(ByPlace[Item]):
    """`length` items; item k is ``make(k)``. The items used last are kept."""

    def __init__(self, length: int, make: Callable[[int], Item], *, keep: int = 1) -> None:
        self._length = length
        self._made = lru_cache(maxsize=keep)(make)

    def __len__(self) -> int:
        return self._length

    def _item(self, place: int) -> Item:
        return self._made(place)
