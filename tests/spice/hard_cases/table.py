"""Run the hard cases and write their table: ``python tests/spice/hard_cases/table.py``.

With ``--slow`` also those that take minutes.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from hard_cases import cases_catch, cases_contact, cases_kick, cases_laws, cases_models  # noqa: F401
from hard_cases.kit import CASES, Outcome, judge

PAGE = Path(__file__).parents[3] / "docs" / "hard_cases.md"
HEAD = """# Hard cases

What breaks circuit simulators, each case with an oracle of its own: scipy, a closed form, or
energy. A case is met when its error is below the limit, or when it ends in a refusal that names the
true reason. "Default options": the same deck without its `.options` cards.

Beside these, `python tests/spice/hard_cases/loops.py` kicks 150 varied chips (damping of 0.01 to
5 %, 10 to 150 V, edges of 1 ns to 5 us, penalty 1e7 to 1e10 N/m) with the scene's own settings.
Every launch must be within 2e-4 of the independent integrator of the same laws; none has more than
a handful of contact events: contact ports answer without inertia ([contact.md](contact.md)).

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
    cells = [case.entry, case.name, case.what, error, limit, str(outcome.points or ""),
             f"{outcome.seconds:.1f}", outcome.text.replace("|", "/"), plain]  # fmt: skip
    return f"| {' | '.join(cells)} |\n"


def converges(number: int) -> str:
    """What ngspice does with a case's decks when their options are stripped."""
    _, bench = judge(CASES[number], plain=True)
    if not bench.decks:
        return ""
    return bench.failures[0] if bench.failures else "converges"


def main() -> None:
    """Write the page, then say how many cases were met."""
    lines, met, plain = [], 0, []
    for number, case in enumerate(CASES):
        if case.slow and "--slow" not in sys.argv:
            continue
        outcome, _ = judge(case)
        met += outcome.met
        plain.append("" if "user circuit" in case.entry else converges(number))
        lines.append(row(outcome, plain[-1].replace("|", "/")))
        print(lines[-1], end="", flush=True)
    ran = [text for text in plain if text]
    share = sum(text == "converges" for text in ran)
    foot = f"\n{met} of {len(lines)} cases are met. "
    foot += f"With ngspice's default options {share} of {len(ran)} decks converge.\n"
    PAGE.write_text(HEAD + "".join(lines) + foot)
    print(foot)


if __name__ == "__main__":
    main()
