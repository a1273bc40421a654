"""Nodal analysis against impedances in closed form."""

import numpy as np
import pytest
from support import NodalCircuit, UsageError, evaluate_parameter, parse_expression, read_cards

LADDER = """\
.subckt ladder in out ref size=1
.param half={size/2} twice={size > 0 ? 4*half : 1}
R1 in a {50*half}
L1 a out 2e-3
C1 out ref {twice*1e-9}
G1 ref x out ref 0.5
R2 x ref 4
E1 y ref x ref 3
R3 y ref 7
V1 rest ref DC 3
R4 rest x 5
.ends ladder
"""


@pytest.mark.parametrize("stages", [1, 40])  # 40: sparse
def test_a_ladder_answers_as_its_impedances(stages):
    cards = LADDER.splitlines()
    copies = [
        " ".join(f"{w}_{k}" if w in "inaoutxyrest" and k else w for w in card.split())
        for k in range(stages)
        for card in cards[2:-1]
    ]
    renamed = [f"{c.split()[0]}_{k} {c.split(None, 1)[1]}" for k, c in enumerate(copies)]
    text = "\n".join([*cards[:2], *renamed, cards[-1]])
    (circuit,) = read_cards(text, "ladder").subcircuits
    f = np.array([1e3, 1e5, 3e5])
    s, size = 2j * np.pi * f, 3.0
    equations = NodalCircuit(circuit).equations({"size": size}, ["ref"], {"held": "in"})
    answers = ["out", "i(held)", "y", "rest"]
    found = equations.solve(s, [{"i(held)": 1.0}], answers)[:, :, 0]
    R, C = 25 * size, 2 * size * 1e-9
    current = 1 / (R + 2e-3 * s + 1 / (s * C))
    out = current / (s * C)
    exact = np.column_stack([out, -current, 3 * 0.5 * out / (1 / 4 + 1 / 5), 0 * s])
    np.testing.assert_allclose(found, exact, rtol=1e-12)


def test_nonlinear_circuits_are_rejected():
    (circuit,) = read_cards(".subckt d a b\nD1 a b x\n.ends d\n", "d").subcircuits
    with pytest.raises(UsageError, match="this element is not linear"):
        NodalCircuit(circuit).equations({}, ["b"], {})
    with pytest.raises(UsageError, match="not a number"):
        evaluate_parameter(parse_expression("2*V(a)"), {})
