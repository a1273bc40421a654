"""Verify scenes of the paper: errors of reduction and netlist against the full model."""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from tables import power, print_table

WHAT = {
    "imprint": "static force",
    "impact": "position over travel",
}


def row(scene: str) -> list[str]:
    """Differences between the stages of one scene."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["kc2spice", "verify", scene, "--quiet", "-o", f"{folder}/out"]
        subprocess.run(words, check=True, stdout=sys.stderr)
        record = json.loads(Path(folder, "out", "verify.json").read_text("utf-8"))
    errors = record["scenes"][scene]["errors"]
    stages = ("rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom")
    return [f"`{scene}`", WHAT[scene], *(power(errors[stage]) for stage in stages)]


if __name__ == "__main__":
    head = ["scene", "error of", "reduced − full", "ngspice − reduced", "ngspice − full"]
    print_table(head, map(row, WHAT))
