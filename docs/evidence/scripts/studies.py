"""Tables of two design studies from the files that ``kc2spice sweep`` writes.

    python docs/evidence/scripts/studies.py envelope|yield SWEEP.CSV

``envelope`` prints the settling time over launch velocity and set point, ``yield`` the share of
random samples that are caught.
"""

import csv
import sys

import numpy as np
from scipy.stats import beta
from tables import print_table

CONFIDENCE = 0.95
FAST = 2e-3  # s: a settling time that a designer may ask for


def number(text):
    """Value of a cell, NaN if the simulation has none."""
    return float(text) if text else np.nan


def envelope(rows):
    """Settling time: one row for each voltage, one column for each set point."""
    heights = sorted({float(row["control.setpoint"]) for row in rows})
    lines = []
    for volts in sorted({float(row["kick.drive.voltage"]) for row in rows}):
        chosen = [row for row in rows if float(row["kick.drive.voltage"]) == volts]
        speed = np.nanmean([number(row["launch_velocity_m_s"]) for row in chosen])
        cells = {float(row["control.setpoint"]): settling(row) for row in chosen}
        lines.append([f"{volts:.0f} V", f"{speed:.2f} m/s", *(cells[h] for h in heights)])
    return ["voltage", "launch velocity", *(f"{1e3 * h:g} mm" for h in heights)], lines


def settling(row):
    """Settling time of a point, or what happens to the sphere instead."""
    if row["status"] != "ok":
        return "leaves the table" if "range of the force table" in row["status"] else "failed"
    return f"{1e3 * number(row['settling_time_s']):.2f} ms" if row["caught"] == "true" else "lost"


def share(count, total):
    """A share in percent with its confidence interval by Clopper and Pearson."""
    tail = (1 - CONFIDENCE) / 2
    low = beta.ppf(tail, count, total - count + 1) if count else 0.0
    high = beta.ppf(1 - tail, count + 1, total - count) if count < total else 1.0
    return f"{100 * count / total:.0f} %", f"{100 * low:.0f} to {100 * high:.0f} %"


def yields(rows):
    """Shares of caught and of fast spheres, and the largest error of the rest position."""
    caught = [row["caught"] == "true" for row in rows]
    fast = [number(row["settling_time_s"]) < FAST for row in rows]
    error = np.nanmax([abs(number(row["final_error_m"])) for row in rows])
    return ["quantity", "value", "95 % confidence"], [
        ["random samples", str(len(rows)), ""],
        ["caught", *share(sum(caught), len(rows))],
        ["settled within 2 ms", *share(sum(fast), len(rows))],
        ["largest error of the rest position", f"{1e6 * error:.1f} µm", ""],
    ]


def main(kind, path):
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    print_table(*{"envelope": envelope, "yield": yields}[kind](rows))


if __name__ == "__main__":
    main(*sys.argv[1:])
