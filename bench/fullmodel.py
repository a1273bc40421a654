"""The full model of a scene's chip: contact transients, what usual code costs."""

from functools import lru_cache

from bench.law import waveforms
from bench.setup import keys_of
from bench.usual.contact import contact_surface
from bench.usual.system import quarter
from kc2spice.bodies.stack_keys import StackKeys
from kc2spice.core.waveforms import Waveforms


def chip(scene):
    """Keys on which the full model of the scene's chip depends."""
    keys = keys_of(scene, "piezo_stack")
    given = StackKeys.model_fields.keys() & keys.model_fields_set
    return StackKeys(**{name: getattr(keys, name) for name in given})


_assembled = lru_cache(maxsize=1)(quarter)


def full_system(scene):
    """One sector of the scene's chip."""
    return _assembled(chip(scene))


def full_surface(scene):
    """The grouped contact springs of the scene on that sector."""
    penalty, radius = keys_of(scene, "contact").penalty, keys_of(scene, "sphere").radius
    return contact_surface(chip(scene), penalty, radius)


def factorisations(ring_force):
    """How often the usual code factorises at least, forces (steps, rings) being known.

    It starts each step from the closed springs of the last one: once to find that they stay, once
    more where they change.
    """
    closed = ring_force > 0
    changed = (closed[1:] != closed[:-1]).any(axis=1)
    return len(closed) + int(changed.sum()) + int(closed[0].any())


def as_waveforms(result, radius, n):
    """Whole-device waveforms of a sector's transient; ``radius`` [m] of the sphere."""
    force, u = n * result.ring_force.sum(axis=1), result.spring_displacement.T
    return waveforms(result.time, result.height + radius, result.velocity, force, u, len(force))


def limit(coarse, fine):
    """Richardson's limit of average acceleration (second order) from steps 2 h and h.

    The load is taken as it is: extrapolation would leave false load where one step size has just
    lost contact.
    """
    data = {name: fine[name][::2] + (fine[name][::2] - coarse[name]) / 3 for name in coarse.data}
    data |= {"time": coarse["time"], "contact.force": fine["contact.force"][::2]}
    return Waveforms(data, {})
