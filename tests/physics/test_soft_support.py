"""Bodies that nothing holds, on a soft support far below their band."""

import math
import warnings

import numpy as np
import pytest
from support import StageTimer, load_scene, support_softly

import kc2spice as kc


def test_a_mass_on_a_soft_support_has_the_response_of_a_free_mass():
    model = kc.LinearModel(M=np.diag([2.0, 3.0]), K=np.array([[5.0, -5.0], [-5.0, 5.0]]),
                           B=np.eye(2), rayleigh=(0.0, 1e-2))  # fmt: skip
    f = np.geomspace(0.01, 1.0, 50)
    s, soft = 2j * np.pi * f, 5.0 * (1 + 2j * np.pi * f * 1e-2)
    exact = soft / (s**2 * (6.0 * s**2 + 5.0 * soft))  # x2 of a force on the first mass
    answer = support_softly(model, (0.01, 1.0)).transfer(f)[:, 1, 0]
    assert np.abs(answer / exact - 1).max() < 2e-8
    assert support_softly(model, (0.0, 1.0)) is model


def test_a_free_disc_with_a_face_has_a_loss_tangent():
    """The full model, whose clamped capacitance alone has the loss.

    ``eps(s) / eps = (j f / 1 kHz)^-m`` with ``m = 2 delta / pi``. The loss factor of the clamped
    part is ``tan(delta + asin(r sin delta))`` with the ratio r of motional to clamped capacitance.
    """
    tangent = 0.02
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scene = load_scene("buzzer_7bb_20_6", {"disc.damping.loss_tangent": tangent})
        model = scene.parts["disc"].type.build(scene.parts["disc"], scene, StageTimer())
    part = scene.parts["disc"]
    full = part.type.get_fe_model(part, scene).model
    names = ["anode", "front_face"]
    f = np.array([700.0, 1e3, 3e3, 6.2e3, 6.4e3, 12e3])
    answers = []
    for each in (model, full):
        rows = [each.outputs.index(name) for name in names]
        columns = [each.inputs.index(name) for name in names]
        answers.append(each.transfer(f)[:, rows][:, :, columns])
    lossy, lossless = answers
    at = full.inputs.index("anode")
    clamped = full.D[at, at]
    ratio = full.facts["capacitance_free_f"] / clamped - 1
    delta = math.atan(tangent)
    angle = delta + math.asin(ratio * math.sin(delta))
    loss = clamped * ((1j * f / 1e3) ** (-2 * angle / np.pi) - 1)
    assert lossy[:, 0, 0] == pytest.approx(lossless[:, 0, 0] + loss, rel=2e-3)
    assert np.abs(loss / lossless[:, 0, 0]).max() > 0.01
    for row, column in ((0, 1), (1, 0), (1, 1)):
        assert lossy[:, row, column] == pytest.approx(lossless[:, row, column], rel=2e-3)
