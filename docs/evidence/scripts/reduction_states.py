"""Reduce the chip of kick_and_catch to several tolerances, for the band alone and for contacts."""

from tables import print_table

import kc2spice as kc

BAND = (0.0, 500e3)  # Hz

if __name__ == "__main__":
    chip = kc.build("kick_and_catch")["kick"]
    print_table(
        ["tolerance", "states, band alone", "states, with contact"],
        (
            [
                f"{tolerance:g}",
                *(
                    str(kc.reduce(chip, tolerance=tolerance, band=BAND, contact=contact).order)
                    for contact in (False, True)
                ),
            ]
            for tolerance in (1e-3, 1e-5, 1e-7)
        ),
    )
