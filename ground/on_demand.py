"""Sequences whose items are made when they are asked for, so that a long run is never in memory as a whole."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TypeVar, overload

Item = TypeVar("Item")


class OnDemand(Sequence[Item]):
    """`length` items, item k being ``make(k)``; those last asked for are kept."""

    def __init__(self, length: int, make: Callable[[int], Item], *, keep: int = 1) -> None:
        self._length = length
        self._made = lru_cache(maxsize=keep)(make)

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, at: int) -> Item: ...

    @overload
    def __getitem__(self, at: slice) -> Sequence[Item]: ...

    def __getitem__(self, at: int | slice) -> Item | Sequence[Item]:
        if isinstance(at, slice):
            return [self._made(k) for k in range(self._length)[at]]
        return self._made(range(self._length)[at])
