"""Run the hard cases and write their table: ``python tests/spice/hard_cases/table.py [WORDS]``.

With ``--slow`` also those that take minutes; with words only the cases that have one of them in
their first two columns, while all others keep their rows.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from hard_cases.every import CASES
from hard_cases.kit import Outcome, judge

PAGE = Path(__file__).parents[3] / "docs" / "notes" / "hard_cases.md"
HEAD = """# Hard cases

What breaks circuit simulators, each case with an oracle of its own: scipy, a closed form, or
energy. A case is met when its error is below the limit, or when it ends in a refusal that names the
true reason. "Default options": the same deck without its `.options` cards.

Beside these, `python tests/spice/hard_cases/loops.py` kicks 150 varied chips (damping of 0.01 to
5 %, 10 to 150 V, edges of 1 ns to 5 us, penalty 1e7 to 1e10 N/m) with the scene's own settings.
Every launch must be within 2e-4 of the independent integrator of the same laws (median 2.9e-5,
largest 1.8e-4); none has more than a handful of contact events: contact ports answer without
inertia ([contact](contact.md)). `hard_cases/budgets.py` draws kicks under error budgets
([speed.md](speed.md)), and `python tests/spice/test_random_scenes.py FIRST LAST` scenes over all
keys, compared with that integrator: launches to 1e-3, heights to 5 um.

Written by `python tests/spice/hard_cases/table.py` (`--slow` adds those that take minutes); times
are wall clock, with the oracle's.

| what is hard | case | error of | error | limit | points | time [s] | outcome | default options |
|---|---|---|---|---|---|---|---|---|
"""


def row(outcome: Outcome, plain: str) -> str:
    """One line of the table."""
    case = outcome.case
    error = "" if outcome.error is None else f"{outcome.error:.1e}"
    limit = "" if case.refused else f"{case.limit:.0e}"
    ended = outcome.text if outcome.met else f"MISSED: {outcome.text}"
    cells = [case.entry, case.name, case.what, error, limit, str(outcome.points or ""),
             f"{outcome.seconds:.1f}", ended.replace("|", "/"), plain]  # fmt: skip
    return f"| {' | '.join(cells)} |\n"


def converges(number: int) -> str:
    """What ngspice does with a case's decks when their options are stripped."""
    _, bench = judge(CASES[number], plain=True)
    if not bench.decks:
        return ""
    return bench.failures[0] if bench.failures else "converges"


def written() -> dict[tuple[str, ...], str]:
    """Rows of the page by their first two columns."""
    lines = PAGE.read_text().partition("|---|")[2].splitlines(keepends=True)
    return {tuple(x.strip() for x in line.split("|")[1:3]): line for line in lines if "| " in line}


def main() -> None:
    """Write the page, then say how many cases were met."""
    words = [word for word in sys.argv[1:] if word != "--slow"]
    rows = written() if words else {}
    for number, case in enumerate(CASES):
        asked = not words or any(word in f"{case.entry} {case.name}" for word in words)
        if not asked or (case.slow and "--slow" not in sys.argv):
            continue
        outcome, _ = judge(case)
        plain = "" if "user circuit" in case.entry else converges(number)
        rows[case.entry, case.name] = row(outcome, plain.replace("|", "/"))
        print(rows[case.entry, case.name], end="", flush=True)
    lines = [rows[key] for case in CASES if (key := (case.entry, case.name)) in rows]
    missed = sum("| MISSED" in line for line in lines)
    ends = [line.split("|")[-2].strip() for line in lines]
    foot = f"\n{len(lines) - missed} of {len(lines)} cases are met. "
    foot += f"With ngspice's default options {ends.count('converges')} of "
    foot += f"{len([end for end in ends if end])} decks converge.\n"
    PAGE.write_text(HEAD + "".join(lines) + foot)
    print(foot)


if __name__ == "__main__":
    main()
