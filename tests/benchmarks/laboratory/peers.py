"""scipy's integrators on the equations of the loop, restarted at the breakpoints of the pulse.

Contact and clamp are kinks that the step control must find; an integrator that is not restarted at
the edges steps over the kick.
"""

from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.model import Scene
from laboratory.law import Law, Mode
from laboratory.segments import initial, segments

IMPLICIT = ("Radau", "BDF", "LSODA")


def integrate(law: Law, scene: Scene, method: str, rtol: float) -> Waveforms:
    """The scene's transient by ``solve_ivp`` with ``method``, restarted at the pulse's edges.

    Raises
    ------
    SimulationError : the integrator gave up.
    """
    x, q = initial(law, scene), law.q
    # what is small: 1 um of any ring or of the sphere, 1 m/s, 1 mA
    atol = rtol * np.concatenate((np.full(2 * q, 1e-6), (1e-6, 1.0, 1.0, 1e-3)))
    times, states = [np.zeros(1)], [x[:, None]]
    for segment in segments(law, scene.stop):
        mode = Mode(segment.start, segment.volt, segment.slope, segment.enabled, None)
        options = {"jac": partial(law.jacobian, mode=mode)} if method in IMPLICIT else {}
        with np.errstate(divide="ignore"):  # scipy divides by an error that is zero at rest
            solution = solve_ivp(
                partial(law.rhs, mode=mode), (segment.start, segment.end), x, method=method,
                rtol=rtol, atol=atol, **options,
            )  # fmt: skip
        if solution.status < 0:
            raise SimulationError(
                f"{method} gave up", where=f"t = {solution.t[-1]:g} s", got=solution.message
            )
        times.append(solution.t[1:])
        states.append(solution.y[:, 1:])
        x = solution.y[:, -1]
    t = np.concatenate(times)
    return law.waveforms(t, np.concatenate(states, axis=1), t.size)
