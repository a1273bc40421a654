"""A scene of a user's own: a chain of six masses, as matrices, that kicks a mass on a spring."""

import numpy as np
from scipy.io import mmwrite

KICKED = """
name = "kicked"
gravity = 0.0

[beam]
part = "matrices"
file = "beam.M.mtx"
sidecar = "beam.toml"
rom = { tolerance = 1e-6, band = ["0 Hz", "100 kHz"] }

[push]
part = "source"
kind = "force"
pulse = { high = "0.2 N", width = "20 us", edge = "4 us", start = "5 us" }
pins = { out = "beam.tip" }

[contact]
penalty = "1e6 N/m"
a = "beam.tip"
b = "ball.a"

[ball]
part = "mass"
mass = "5 mg"

[hold]
part = "spring"
stiffness = "2e3 N/m"
pins = { a = "ball.a" }

[solver]
reltol = 1e-5
max_step = "0.5 us"
stop = "150 us"

[gates]
launch_full_model = 1.2e-3  # 9.2e-4: the contact excites two modes above the band that are left out
launch_velocity = 5e-4    # measured 1.7e-4 at this speed of 8 cm/s
metrics = 5e-4            # measured 2.5e-4: 3.6 ns of launch time between two steps
waves = 5e-3              # measured 3.0e-3: ringing of the chain after the ball has left
"""


def kicked(folder):
    """A chain of six masses that kicks a mass on a spring; its matrices stand beside the scene."""
    n, k, m = 6, 4e6, 2e-6
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = k
    B = np.zeros((n, 1))
    B[-1] = 1.0
    for letter, values in {"M": m * np.eye(n), "K": K, "E": 1e-8 * K, "B": B, "C": B.T}.items():
        mmwrite(folder / f"beam.{letter}.mtx", values)
    (folder / "beam.toml").write_text('[[ports]]\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n')
    path = folder / "kicked.toml"
    path.write_text(KICKED)
    return path
