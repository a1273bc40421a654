"""A deck edited by hand, with all metrics, checks and plots of its scene."""

from pathlib import Path

import kc2spice as kc

deck = kc.deck("impact")
folder = Path("edited")
folder.mkdir()
for name, text in deck.files.items():
    (folder / name).write_text(text)

netlist = folder / deck.main_file_name
lines = netlist.read_text().splitlines()
# A resistor across the anode, which the scene leaves open, takes energy out of the chip.
place = next(k for k, line in enumerate(lines) if line.startswith("Xkick"))
netlist.write_text("\n".join([*lines[: place + 1], "Rload kick_anode 0 10", *lines[place + 1 :]]))

before, after = kc.run("impact"), kc.run("impact", deck=netlist)
print(after)
assert after.metrics["rebound_velocity_m_s"] < before.metrics["rebound_velocity_m_s"]
