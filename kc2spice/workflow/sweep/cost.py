"""What a sweep costs in processor time, ngspice and everything else apart."""

from __future__ import annotations

import os
from dataclasses import dataclass


@dataclass(frozen=True)
class Cost:
    """CPU seconds: ``own`` of Python, ``simulator`` of the ngspice runs."""

    own: float = 0.0
    simulator: float = 0.0

    def __add__(self, other: Cost) -> Cost:
        return Cost(self.own + other.own, self.simulator + other.simulator)

    def summary(self, workers: int, wall: float) -> dict[str, float | None]:
        """``busy_share`` of the workers' time that any CPU was used, ``overhead`` over ngspice.

        ``overhead`` is the CPU of Python per CPU of ngspice; None where nothing was run, or where
        the system does not tell what child processes used.
        """
        available = workers * wall
        return {
            "ngspice_cpu_s": self.simulator,
            "python_cpu_s": self.own,
            "busy_share": (self.own + self.simulator) / available if available else None,
            "overhead": self.own / self.simulator if self.simulator else None,
        }


NOTHING = Cost()


class Meter:
    """Reads the clocks of this process; nothing between two readings is lost."""

    def __init__(self) -> None:
        self._read = NOTHING  # so that the first reading holds the start of the process

    def since_last(self) -> Cost:
        """CPU of this process and of the children it has waited for, since the last call."""
        times = os.times()
        now = Cost(times.user + times.system, times.children_user + times.children_system)
        before, self._read = self._read, now
        return Cost(now.own - before.own, now.simulator - before.simulator)


METER = Meter()  # of this process, worker or parent
