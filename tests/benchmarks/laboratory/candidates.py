"""Which reduction needs the fewest states? Candidates side by side, judged by the full model.

``python -m laboratory.candidates`` prints the tables of docs/reduction.md and draws their
figure. Three errors count: harmonic (all port pairs over the band), impact and launch of the
sphere. Contact excites the MHz range, so a model fitted to the band alone may be wrong there.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.core.cache import cached
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.keys import Chip
from kc2spice.fem.piezo.system import PiezoSystem
from kc2spice.parts.contact import ContactKeys
from kc2spice.parts.piezo_stack import Drive
from kc2spice.parts.sphere import SphereKeys
from kc2spice.parts.throw import ThrowKeys
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import Reduction, ordered
from kc2spice.rom.response import relative_error
from kc2spice.rom.subspace import subspace
from kc2spice.rom.surrogate import surrogate
from laboratory.candidate_figure import candidate_figure
from laboratory.reductions import Candidate, candidates, leading, of_pencil
from laboratory.usual.contact import ContactSurface, as_system, contact_surface, on_reduced
from laboratory.usual.transient import Ball, transient

BAND = (0.0, 500e3)
FREQUENCY = np.linspace(*BAND, 463)
ORDERS = (14, 16, 18, 20, 22, 26)
ERRORS = ("harmonic", "impact", "launch")
TOLERANCE = 2e-7  # that the shipped reduction weights its snapshots for
LARGE = 1e-10  # residual of the first stage, whose error then does not count
SHIPPED = "static vectors, weighted POD (ships)"
# Of both models, so that the reduction alone differs. One launch may be right by luck: four count.
IMPACT_STEP, IMPACT_STOP = 50e-9, 15e-6  # s
LAUNCH_STEP, LAUNCH_STOP = 20e-9, 6.2e-6  # s
LAUNCH_VOLTAGES = (60.0, 80.0, 100.0, 120.0)
GRAVITY = 9.81


@dataclass(frozen=True)
class Judged:
    """Relative errors of one candidate at one order.

    ``harmonic`` is the largest over all 49 pairs and the band, ``impact`` that of the sphere's path
    over its travel, ``launch`` the root mean square of the launch velocities' errors.
    """

    candidate: str
    order: int
    harmonic: float
    impact: float
    launch: float


@dataclass(frozen=True)
class Contacts:
    """The same sphere on the full chip or on a reduced one."""

    system: PiezoSystem
    surface: ContactSurface
    sphere: SphereKeys

    def impact(self) -> np.ndarray:
        """Height of the falling sphere [m] over the steps."""
        ball = Ball(self.sphere.mass / self.system.sectors, ThrowKeys().gap, ThrowKeys().velocity)
        run = transient(
            self.system, self.surface, ball, step=IMPACT_STEP, stop=IMPACT_STOP, voltage=None
        )
        return run.height

    def launch(self) -> np.ndarray:
        """Velocity [m/s] after kicks of ``LAUNCH_VOLTAGES`` under the resting sphere."""
        ball = Ball(self.sphere.mass / self.system.sectors, 0.0, 0.0, GRAVITY)
        runs = [
            transient(
                self.system, self.surface, ball, step=LAUNCH_STEP, stop=LAUNCH_STOP,
                voltage=Drive(voltage=volts, start=0.0).waveform, resting=True,
            )
            for volts in LAUNCH_VOLTAGES
        ]  # fmt: skip
        return np.array([run.velocity[-1] for run in runs])


class Judge:
    """The full model's answers, computed once and kept in the cache."""

    def __init__(self, system: PiezoSystem, model: LinearModel, kick: Chip) -> None:
        sphere = SphereKeys()
        surface = contact_surface(kick, ContactKeys().penalty, sphere.radius)
        self.full = Contacts(system, surface, sphere)

        def build() -> dict[str, np.ndarray]:
            reference = surrogate(model, BAND).model
            return {
                "harmonic": reference.transfer(FREQUENCY),
                "impact": self.full.impact(),
                "launch": self.full.launch(),
            }

        key = {
            "kick": kick.model_dump(mode="json"),
            "experiments": [IMPACT_STEP, IMPACT_STOP, LAUNCH_STEP, LAUNCH_STOP],
        }
        key |= {"voltages": LAUNCH_VOLTAGES}
        sources = ("kc2spice.fem", "kc2spice.rom")
        self.exact, _ = cached("candidates", key, build, sources=sources)

    def __call__(self, name: str, rom: LinearModel) -> Judged:
        full, exact = self.full, self.exact
        own = Contacts(as_system(rom, full.system), on_reduced(full.surface, rom), full.sphere)
        path = np.abs(own.impact() - exact["impact"]).max() / np.ptp(exact["impact"])
        launch = np.sqrt(np.mean((own.launch() / exact["launch"] - 1) ** 2))
        harmonic = relative_error(rom.transfer(FREQUENCY), exact["harmonic"])
        return Judged(name, rom.order, harmonic, float(path), float(launch))


def shipped(model: LinearModel, tolerance: float = TOLERANCE) -> tuple[LinearModel, Reduction]:
    """The large model of the first stage, and the second stage that orders its directions."""
    space = subspace(model.pencil, BAND, LARGE, 1e3 * LARGE, "scipy")
    return of_pencil(model, space.pencil), ordered(model, space, BAND, False, tolerance)


def compare(kick: Chip, orders: tuple[int, ...] = ORDERS) -> list[Judged]:
    """Every candidate at every order."""
    system = assemble_kick(kick)
    model = from_sector(system)
    judge = Judge(system, model, kick)
    large, reduction = shipped(model)
    whole = of_pencil(model, reduction.pencil)
    methods: dict[str, Candidate] = {SHIPPED: lambda order: leading(whole, order)}
    methods |= candidates(model, large, BAND, max(orders))
    return [judge(name, make(order)) for name, make in methods.items() for order in orders]


def table(found: list[Judged], error: str) -> str:
    """Markdown: one row for each candidate, one column for each order."""
    orders = sorted({one.order for one in found})
    value = {(one.candidate, one.order): getattr(one, error) for one in found}
    names = dict.fromkeys(one.candidate for one in found)
    lines = [[f"{error} error, states:", *map(str, orders)], ["---"] * (len(orders) + 1)]
    lines += [[name, *(f"{value[name, order]:.0e}" for order in orders)] for name in names]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _main() -> None:
    parser = argparse.ArgumentParser(prog="python -m laboratory.candidates", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("candidates"), help="Directory to write.")
    directory = parser.parse_args().out
    found = compare(Chip())
    text = "\n\n".join(table(found, error) for error in ERRORS)
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "candidates.md").write_text(text + "\n", encoding="utf-8")
    series = {
        error: {
            name: [(one.order, getattr(one, error)) for one in found if one.candidate == name]
            for name in dict.fromkeys(one.candidate for one in found)
        }
        for error in ERRORS
    }
    candidate_figure(directory / "candidates.png", series)
    print(text)


if __name__ == "__main__":
    _main()
