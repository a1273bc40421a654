"""Print the results of kick_and_catch beside those of the paper (Schütz et al. 2021)."""

from tables import print_table

import kc2spice as kc

if __name__ == "__main__":
    result = kc.run("kick_and_catch")
    metrics, chip = result.metrics, result.record["model"]["kick"]
    states = result.record["rom"]["order"]
    resonances = (chip["resonance_short_hz"], chip["resonance_open_hz"])
    capacitances = (chip["capacitance_free_f"], chip["capacitance_clamped_f"])
    distance = 1e9 * abs(metrics["final_error_m"])
    stroke = 1e6 * chip["free_stroke_ring0_m_per_100v"]
    rows = {
        "unknowns of the full chip": (f"{chip['unknowns']}", "16702"),
        "states of the reduced chip": (f"{states}", "30"),
        "free stroke at 100 V (data sheet 2.2 µm)": (f"{stroke:.3f} µm", ""),
        "capacitance of the chip, free / clamped": (
            " / ".join(f"{1e9 * c:.1f} nF" for c in capacitances), "",
        ),
        "lowest resonance, anode shorted / open": (
            " / ".join(f"{1e-3 * f:.1f} kHz" for f in resonances), "about 250 kHz",
        ),
        "launch velocity": (f"{metrics['launch_velocity_m_s']:.3f} m/s", ""),
        "inside ±5 % of the step from": (f"{1e3 * metrics['settling_time_s']:.2f} ms", "3 ms"),
        "distance from the set point at 5 ms": (f"{distance:.0f} nm", ""),
        "coil current that holds the sphere": (f"{1e3 * metrics['hold_current_a']:.2f} mA", ""),
    }  # fmt: skip
    print_table(["quantity", "kc2spice", "paper"], ([name, *row] for name, row in rows.items()))
