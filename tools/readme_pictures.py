#!/usr/bin/env python3
"""Draw the pictures of the README: a device, its circuit, and what a run of it found.

    python tools/readme_pictures.py

Writes ``buzzer_device.svg``, ``buzzer_circuit.svg`` and ``buzzer_impedance.png`` into
``docs/figures``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import kc2spice as kc
from kc2spice.report.drawings import draw_circuit, draw_side_view

SCENE = "buzzer_7bb_20_6"
FIGURES = Path(__file__).resolve().parents[1] / "docs" / "figures"


def main() -> None:
    """Write the three pictures."""
    import matplotlib.pyplot as plt

    scene = kc.load_scene(SCENE)
    for name, drawing in (("device", draw_side_view(scene)), ("circuit", draw_circuit(scene))):
        (FIGURES / f"buzzer_{name}.svg").write_text(drawing.strip() + "\n", encoding="utf-8")
    metrics = kc.run(scene).metrics
    frequency, impedance = (np.array(metrics[n]) for n in ("frequency_hz", "impedance_ohm"))
    figure, axes = plt.subplots(figsize=(4.6, 3.0), layout="constrained")
    axes.semilogy(frequency / 1e3, impedance, color="#0072B2")
    for key, label in (("resonance_hz", "series"), ("antiresonance_hz", "parallel")):
        axes.axvline(metrics[key] / 1e3, color="#888", lw=0.8)
        axes.annotate(
            f"{label}\n{metrics[key] / 1e3:.2f} kHz",
            (metrics[key] / 1e3, impedance.max()),
            ha="right" if label == "series" else "left",
            va="top",
            fontsize=8,
        )
    axes.set(
        xlabel="frequency in kHz",
        ylabel="impedance in Ω",
        title="The buzzer resonates at 6.30 kHz",
    )
    figure.savefig(FIGURES / "buzzer_impedance.png", dpi=110)


if __name__ == "__main__":
    main()
