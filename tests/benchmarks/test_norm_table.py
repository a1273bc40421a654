"""The table of norms in docs/reduction.md says what was reduced, to what, and what it took."""

from laboratory import norms


def test_each_model_is_a_row_of_both_norms(monkeypatch):
    monkeypatch.setattr(norms, "CASES", {"rod": lambda: norms.heat(60)})
    head, _, row = norms.rows()
    name, tolerance, states, error, _, fewer, peak, _ = row.strip("| ").split(" | ")
    assert head.count("|") == row.count("|")
    assert (name, tolerance) == ("rod", "0.0001")
    assert int(fewer) < int(states)
    assert max(float(error), float(peak)) <= 1e-4
