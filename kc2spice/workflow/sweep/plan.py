"""The points of a sweep: counted, numbered and generated one by one, never held all at once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import prod

import numpy as np

from kc2spice import __version__
from kc2spice.core.errors import UsageError
from kc2spice.workflow.sweep.ranges import MAX_POINTS, PARAMETER, Grid, Random, Value


@dataclass(frozen=True)
class Plan:
    """Swept ``keys`` in the order of the command line and the values that they take.

    ``blocks`` are crossed, the last one varies fastest; within a block the columns (one for each
    key named by ``members``, as positions in ``keys``) vary together. ``random`` names the keys
    that were drawn.
    """

    keys: tuple[str, ...]
    members: tuple[tuple[int, ...], ...]
    blocks: tuple[tuple[tuple[Value, ...], ...], ...]
    random: tuple[str, ...]

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        """Number of steps of each block."""
        return tuple(len(block[0]) for block in self.blocks)

    @property
    def size(self) -> int:
        """Number of points."""
        return prod(self.lengths)

    def values(self, index: int) -> tuple[Value, ...]:
        """Values of all keys at point ``index``, 0 … size - 1."""
        found: list[Value] = [0.0] * len(self.keys)
        for members, block in zip(reversed(self.members), reversed(self.blocks), strict=True):
            index, step = divmod(index, len(block[0]))
            for member, column in zip(members, block, strict=True):
                found[member] = column[step]
        return tuple(found)

    def order(self, slow: Sequence[int]) -> Iterator[int]:
        """All points such that the blocks ``slow`` vary slowest: neighbours share their models."""
        fast = [block for block in range(len(self.blocks)) if block not in slow]
        ranking = [*slow, *fast]
        strides = [prod(self.lengths[block + 1 :]) for block in ranking]
        counts = [self.lengths[block] for block in ranking]
        for number in range(self.size):
            index = 0
            for count, stride in zip(reversed(counts), reversed(strides), strict=True):
                number, step = divmod(number, count)
                index += step * stride
            yield index

    def distinct(self, keys: Sequence[str]) -> int:
        """How many combinations of values the given keys take in all points."""
        wanted = {self.keys.index(key) for key in keys}
        total = 1
        for members, block in zip(self.members, self.blocks, strict=True):
            columns = [c for m, c in zip(members, block, strict=True) if m in wanted]
            total *= len(set(zip(*columns, strict=True))) if columns else 1
        return total

    def digest(self, context: object) -> str:
        """Hash of ``context`` (whatever else decides the results) and of every value."""
        digest = hashlib.sha256(json.dumps([__version__, context], sort_keys=True).encode())
        digest.update(repr((self.keys, self.members)).encode())
        for block in self.blocks:
            for column in block:
                digest.update(repr(column).encode())
        return digest.hexdigest()[:16]


def make_plan(
    ranges: Sequence[Grid | Random], *, zipped: bool = False, latin: bool = False, seed: int = 0
) -> Plan:
    """Cross the grids with each other and with the draws, or step through all together.

    One draw is a draw of all random keys, so these form one block. ``latin`` stratifies it: every
    key's n equally likely intervals are each hit once (McKay, Beckman, Conover 1979).

    Raises
    ------
    UsageError : nothing to sweep, a key twice, unequal lengths, too many points.
    """
    keys = tuple(item.key for item in ranges)
    for key in keys:
        if keys.count(key) > 1:
            raise UsageError("swept twice", where="--set", got=key)
    if not ranges:
        raise UsageError("nothing to sweep", where="--set", expected="--set KEY=a:b:n")
    grids = [position for position, item in enumerate(ranges) if isinstance(item, Grid)]
    draws = [position for position, item in enumerate(ranges) if isinstance(item, Random)]
    columns: dict[int, tuple[Value, ...]] = {
        i: item.values for i, item in enumerate(ranges) if isinstance(item, Grid)
    }
    random = [item for item in ranges if isinstance(item, Random)]
    _same_length({item.key: item.n for item in random}, "draws")
    columns |= dict(zip(draws, _drawn(random, latin, seed), strict=True))
    if zipped:
        members = (tuple(range(len(keys))),)
        _same_length({keys[i]: len(column) for i, column in columns.items()}, "--zip")
    else:
        members = (*((i,) for i in grids), *((tuple(draws),) if draws else ()))
    blocks = tuple(tuple(columns[i] for i in member) for member in members)
    plan = Plan(keys, members, blocks, tuple(item.key for item in random))
    if plan.size > MAX_POINTS:
        raise UsageError("too many points", got=plan.size, expected=f"at most {MAX_POINTS}")
    return plan


def _same_length(lengths: dict[str, int], where: str) -> None:
    if len(set(lengths.values())) > 1:
        got = ", ".join(f"{key}: {length}" for key, length in lengths.items())
        raise UsageError("unequal numbers of values", where=where, got=got, expected="one number")


def _drawn(random: Sequence[Random], latin: bool, seed: int) -> list[tuple[Value, ...]]:
    if not random:
        return []
    generator = np.random.default_rng(seed)
    n, keys = random[0].n, len(random)
    share = generator.random((keys, n))
    if latin:
        from scipy.stats.qmc import LatinHypercube

        share = LatinHypercube(keys, seed=generator).random(n).T
    share = np.clip(share, 2.0**-53, 1 - 2.0**-53)  # a normal quantile of 0 would be infinite
    return [tuple(item.quantile(u).tolist()) for item, u in zip(random, share, strict=True)]


def deck_keys(keys: Sequence[str]) -> tuple[str, ...]:
    """Those of ``keys`` that change the netlist and not only its parameters."""
    return tuple(key for key in keys if not key.startswith(PARAMETER))
