"""Summarise random scenes, read as lines of JSON from standard input, by family.

The lines are those of tests/spice/test_random_parts.py or tests/spice/hard_cases/budgets.py.
"""

import json
import sys
from collections import Counter, defaultdict

from tables import print_table

WORDS = {
    "right": "right",
    "holds": "right",
    "off": "off, with a warning",
    "said": "off, with a warning",
}
SILENT = "off without a warning"
COLUMNS = ("right", "off, with a warning", "refused", "timed out", SILENT)

counts: dict[str, Counter[str]] = defaultdict(Counter)
errors = defaultdict(list)
for text in sys.stdin:
    line = json.loads(text)
    if "family" not in line:
        continue
    word = line.get("word", line.get("outcome")).partition(":")[0].partition(",")[0]
    column = WORDS.get(word, SILENT if word in ("OFF", "SILENT") else word)
    counts[line["family"]][column] += 1
    if isinstance(line["error"], float) and line["error"] == line["error"]:
        errors[line["family"]].append(line["error"])

total = sum(counts.values(), Counter())
rows = [
    [name, *(str(count[column]) for column in COLUMNS), f"{max(errors[name], default=0):.0e}"]
    for name, count in counts.items()
]
print_table(["family", *COLUMNS, "largest error"], rows)
print("| **all** |", " | ".join(str(total[column]) for column in COLUMNS), "| |")
