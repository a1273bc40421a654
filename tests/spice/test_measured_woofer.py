"""A measured woofer: a fit of two impedances predicts a third one with another added mass.

Rows of ``L16RNX_0g``, ``_8_017g`` and ``_16_048g_242_27mV.zma`` of a SEAS L16RNX, in
github.com/jcandy/speakertools, src/data. Its authors J. Candy and C. Futtrup state B l = 7.009 N/A.
"""

import numpy as np
import pytest
from support import MeasuredAdmittance

import kc2spice as kc

FREQUENCIES = (10, 14, 19.99, 24.86, 29.7, 34.8, 37.67, 41.58, 45.01, 47.77, 51.7, 58.22, 69.57,
               89.99, 131.08, 198.64, 301.01)  # fmt: skip
# Magnitudes [Ohm] and phases [degrees] by added mass [g].
ROWS = {
    0.0: (
        (7.1179, 8.166, 10.3099, 12.7487, 16.071, 20.7555, 23.7829, 27.477, 29.0178, 28.5544,
         26.0265, 20.9237, 15.0706, 10.4821, 7.6688, 6.5775, 6.2984),
        (25.224, 31.548, 37.466, 39.335, 38.038, 32.026, 25.646, 13.378, 0.348, -10.015, -22.344,
         -34.617, -41.674, -39.816, -29.704, -16.883, -5.429),
    ),
    8.017: (
        (7.1929, 8.4392, 11.34, 15.2426, 21.1801, 27.3186, 27.4685, 23.8672, 20.1626, 17.6746,
         14.9993, 12.1476, 9.6357, 7.7478, 6.5932, 6.2221, 6.4476),
        (25.782, 32.418, 38.082, 37.514, 28.886, 6.862, -8.805, -25.653, -34.339, -38.181, -40.837,
         -41.225, -38.24, -30.336, -18.83, -7.78, 2.404),
    ),
    16.048: (
        (7.3166, 8.774, 12.7565, 18.9479, 26.2936, 23.4779, 19.6039, 15.5693, 13.2347, 11.8983,
         10.5343, 9.0949, 7.8238, 6.8672, 6.2815, 6.1379, 6.2619),
        (26.359, 33.318, 37.86, 31.536, 7.348, -24.337, -33.903, -39.605, -40.983, -40.838, -39.711,
         -36.614, -31.308, -22.913, -12.885, -4.002, 3.716),
    ),
}  # fmt: skip
START = {"re": 5.9, "bl": 6.5, "mms": 14e-3, "fs": 46.0, "rms": 1.9, "creep": 0.05, "ke": 0.04}
VARIED = {
    "re": (5, 7), "bl": (5, 9), "mms": (0.01, 0.02), "fs": (40, 50), "rms": (0.5, 5),
    "creep": (0.01, 0.3), "ke": (0.01, 0.2),
}  # fmt: skip


def curve(grams):
    size, phase = map(np.array, ROWS[grams])
    Y = 1 / (size * np.exp(1j * np.radians(phase)))
    f = np.array(FREQUENCIES, dtype=float)
    return MeasuredAdmittance(f"{grams} g", f"{grams} g", f, Y[:, None, None])


@pytest.mark.slow
def test_two_masses_predict_a_third_within_two_percent():
    part = {"part": "loudspeaker", **START, "le": 1.6e-3, "pins": {"plus": "drive.out"}}
    tables = {"woofer": part, "drive": {"part": "source", "ac": 1.0}}
    curves = []
    for grams in ROWS:
        mass = {"woofer.added_mass": f"{grams} g"}
        curves.append({"file": curve(grams), "set": mass, "predict": grams > 10})
    result = kc.fit(tables, "woofer", curves, VARIED)
    predicted = result["curves"][2]
    assert predicted["predict"]
    assert predicted["largest"] < 0.02
    assert result["values"]["woofer.bl"] == pytest.approx(7.009, rel=0.01)
