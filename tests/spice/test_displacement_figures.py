"""Displacements of radiating surfaces in the report against full models and closed forms."""

import math

import numpy as np
import pytest
from support import disc

import kc2spice as kc

RADIUS = 10e-3
LAYERS = [
    {"material": "brass", "diameter": 2 * RADIUS, "thickness": 0.2e-3},
    {"material": "PZT-5A", "diameter": 14e-3, "thickness": 0.22e-3, "electrodes": 12.8e-3},
]
BODY = {"layers": LAYERS, "support": "simply_supported", "damping": {"quality": 50}}
FREE_FIELD = {"front": {"part": "radiation", "radius": RADIUS, "pins": {"face": "disc.front_face"}}}
HOUSING = {
    "chamber": {"part": "cavity", "volume": "0.8 cm3", "pins": {"a": "disc.front_face"}},
    "hole": {"part": "vent", "radius": "1.5 mm", "length": "1 mm", "pins": {"a": "chamber.a"}},
}
SWEEP = {"type": "ac", "start": "500 Hz", "stop": "3.6 kHz", "points": 60}
PREFIX = {"nm": 1e-9, "µm": 1e-6, "mm": 1e-3}


def run_disc(loads, source, analysis):
    return kc.run(
        {
            "disc": {"part": "disc", **BODY, "pins": {"anode": "drive.out"}},
            "drive": {"part": "source", **source},
            "analysis": analysis,
            **loads,
        }
    )


def respond(output, source, f):
    """Response of the full model at a frequency [Hz]."""
    model = disc.make_disc_blocks(BODY).build_fe_model().model
    return model.transfer(f)[:, model.outputs.index(output), model.inputs.index(source)]


def read_curve(figure):
    """Scale [Hz or s] and displacement [m] of the curve of a figure."""
    (panel,) = figure.panels
    (curve,) = panel.curves
    scale = {"kHz": 1e3, "Hz": 1.0, "ms": 1e-3}[panel.x.rpartition(" in ")[2]]
    return scale * curve.x, PREFIX[panel.y.rpartition(" in ")[2]] * curve.y


@pytest.mark.parametrize("loads", [FREE_FIELD, HOUSING], ids=["free field", "housing"])
def test_the_mean_displacement_of_a_face_is_that_of_the_full_model(loads):
    """Volume of the full model under the voltage and the recorded pressure, over pi a^2."""
    result = run_disc(loads, {"ac": 1.0}, SWEEP)
    f, amplitude = read_curve(result.figures["disc_displacement"])
    assert f == pytest.approx(result.frequency, rel=1e-9)
    volume = respond("front_face", "anode", f) * 1.0
    volume += respond("front_face", "front_face", f) * result.waves["disc.pressure.front_face"]
    assert amplitude == pytest.approx(np.abs(volume) / (math.pi * RADIUS**2), rel=2e-3)
    peak = np.abs(volume).max() / (math.pi * RADIUS**2)
    title = result.figures["disc_displacement"].title
    assert title.startswith(f"Mean displacement of disc: at most {1e6 * peak:.3g} µm, at 2.")


def test_the_caption_states_the_largest_displacement_at_the_resonance():
    """The centre of a supported disc moves most; the full model has a port there."""
    result = run_disc(FREE_FIELD, {"ac": 1.0}, SWEEP)
    caption = result.figures["disc_displacement"].caption
    place = np.array([float(caption.partition("At ")[2].partition(" kHz")[0]) * 1e3])
    ratio, _, size = caption.partition("about ")[2].partition(" times the mean: ")
    pressure = np.interp(place, result.frequency, result.waves["disc.pressure.front_face"])
    centre, volume = (
        (respond(port, "anode", place) + pressure * respond(port, "front_face", place))[0]
        for port in ("centre", "front_face")
    )
    assert float(ratio) == pytest.approx(abs(centre / volume) * math.pi * RADIUS**2, rel=0.05)
    assert float(size.split()[0]) * 1e-6 == pytest.approx(abs(centre), rel=0.05)


def test_a_slow_voltage_moves_a_face_to_the_static_displacement():
    source = {"pulse": {"high": "10 V", "width": "1 s", "edge": "3 ms"}}
    result = run_disc(FREE_FIELD, source, {"type": "transient", "stop": "8 ms"})
    t, motion = read_curve(result.figures["disc_displacement"])
    static = respond("front_face", "anode", np.array([1.0]))[0].real
    # the port counts the volume that the face yields, the figure the motion outwards
    expected = -10 * static / (math.pi * RADIUS**2)
    assert t[-1] == pytest.approx(8e-3)
    assert motion[-1] == pytest.approx(expected, rel=1e-2)


def test_a_cone_moves_by_the_force_of_its_coil_over_its_stiffness():
    """Far below the resonance, x = Bl V / Re Cms."""
    keys = {"bl": 7.3, "cms": 1.5e-4, "rms": 2.44, "mmd": 26.29e-3, "re": 2.6, "sd": 0.022}
    scene = {
        "woofer": {"part": "loudspeaker", **keys, "xmax": 7e-3, "pins": {"plus": "drive.out"}},
        "drive": {"part": "source", "ac": 1.0},
        "analysis": {"type": "ac", "start": "0.1 Hz", "stop": "1 Hz", "points": 10},
    }
    figure = kc.run(scene).figures["woofer_displacement"]
    amplitude = read_curve(figure)[1]
    assert amplitude[0] == pytest.approx(7.3 / 2.6 * 1.5e-4, rel=1e-3)
    assert "7 mm" in figure.caption


def test_a_body_without_sound_has_no_such_figure():
    assert "disc_displacement" not in run_disc({}, {"ac": 1.0}, SWEEP).figures
