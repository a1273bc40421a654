"""Write docs/bench/fronts.md: where the shipped setting of each scene lies among its own settings.

for scene in impact kick_and_catch; do kc2spice bench $scene --repeats 3 --out out/fronts/$scene; done
python tools/fronts.py out/fronts
"""  # noqa: E501

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from kc2spice.report.words import quantity
from kc2spice.workflow.bench.plane import place_of_own

TARGET = Path(__file__).parents[1] / "docs" / "bench" / "fronts.md"
HEAD = """# Shipped settings and their fronts

`kc2spice bench SCENE --repeats 3` of scenes whose run takes less than a second, CPU times of
ngspice on a busy machine: `tools/fronts.py`. An error is the larger of the whole setting's and of
the sum of what its values do alone, of the scene's metrics, against all keys at their finest. A
setting is beaten by one as exact in clearly less time (a fifth and 5 ms less, and less than its
quickest run), or by one that takes no longer at half the error. `kick_and_catch` keeps the 30
states of the paper, which its figures are compared with; `error_budget` chooses better ones.

| scene | error | time | beaten by | error | time |
|---|---|---|---|---|---|
"""


def row(record: dict[str, Any]) -> str:
    """One scene: what it ships with, and the quickest setting that beats it."""
    own = next(point for point in record["points"] if point["own"])
    floor = record["reference"]["error"]
    nearest = place_of_own(record["points"], floor)
    cells = [f"`{record['scene']}`", f"{max(own['error'], own['bound'], floor):.1e}",
             quantity(own["time_s"], "s", 3)]  # fmt: skip
    if nearest["on_front"]:
        cells += ["none: on the front", "", ""]
    else:
        cells += [
            nearest["nearest"],
            f"{nearest['error']:.1e}",
            quantity(nearest["time_s"], "s", 3),
        ]
    return f"| {' | '.join(cells)} |\n"


def main(folder: Path) -> None:
    records = [json.loads(path.read_text()) for path in sorted(folder.glob("*/bench.json"))]
    TARGET.write_text(HEAD + "".join(map(row, records)), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
