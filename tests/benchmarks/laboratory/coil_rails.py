"""Draws docs/coil_rails.png: which launches does the catch lose, between which supply rails?

    PYTHONPATH=tests/benchmarks python -m laboratory.coil_rails [--out docs]

Runs the scene ``coil_rails`` for every rail and kick voltage (about two minutes) and keeps the
numbers beside the figure in ``coil_rails.csv``.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from kc2spice.core.progress import Clock
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import metrics
from kc2spice.workflow.models import build_models
from laboratory.rails import Launch, rails_figure

RAILS = (15.0, 24.0, 48.0, 100.0, 200.0)
KICKS = np.arange(20.0, 201.0, 10.0)


def launches(rail: float) -> list[Launch]:
    """All kicks against one pair of rails."""
    found = []
    for kick in KICKS:
        overrides = [f"catch.driver.linear.rail={rail}", f"kick.drive.voltage={kick}"]
        scene = load_scene("coil_rails", overrides)
        build = build_models(scene, Clock())
        with tempfile.TemporaryDirectory() as directory:
            waves = run_deck(make_deck(build), Path(directory), timeout=120)
        facts = metrics(waves, build)
        if facts["launch_velocity_m_s"] is not None:
            speed, caught = facts["launch_velocity_m_s"], bool(facts["caught"])
            found.append(Launch(rail, speed, facts["peak_height_m"], caught))
            print(f"{rail:5g} V  {speed:.3f} m/s  {'caught' if caught else 'lost'}", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs"))
    out = parser.parse_args().out
    out.mkdir(exist_ok=True)
    scene = load_scene("coil_rails")
    table = build_models(scene, Clock()).model("catch")
    points = [launch for rail in RAILS for launch in launches(rail)]
    rows = [(p.rail, p.speed, p.peak, p.caught) for p in points]
    head = "rail [V],launch velocity [m/s],peak height [m],caught"
    np.savetxt(out / "coil_rails.csv", rows, "%.6g", ",", header=head, comments="")
    rails_figure(out / "coil_rails.png", points, scene, table)


if __name__ == "__main__":
    main()
