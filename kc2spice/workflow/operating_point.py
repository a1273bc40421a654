"""Operating point at which ``ac`` and ``noise`` analyses are linearised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.equations.scene_laws import SceneLaws
from kc2spice.netlist.deck import Deck
from kc2spice.scene.checks import Check
from kc2spice.scene.scene_classes import BuiltScene
from kc2spice.scene.settings import Analysis
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.part_models import rebuild_with_scene


@dataclass(frozen=True)
class OperatingPoint:
    """Results of all parts at an operating point, with their checks.

    ``waves`` contains the results as arrays with one value, and is None if no operating point is
    known.
    """

    values: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    checks: tuple[Check, ...] = ()
    waves: Waveforms | None = None

    def list_checks(self, build: BuiltScene, waves: Waveforms) -> tuple[Check, ...]:
        """Return checks of the operating point, and of the amplitudes of an ac analysis.

        The result omits each check that the scene disables.
        """
        checks = list(self.checks)
        for name, part in build.scene.parts.items() if build.scene.analysis.type == "ac" else ():
            if name not in build.unchecked_parts:
                checks += part.type.check_amplitudes(part, build, self.waves, waves)
        return tuple(check for check in checks if check.action != "off")


def find_operating_point(build: BuiltScene, deck: Deck, laws: SceneLaws) -> OperatingPoint:
    """Find the operating point of a small-signal analysis in a separate run.

    The result is empty for edited decks, and for analyses that are not small-signal analyses. The
    result is also empty for scenes with linear parts only, because responses of linear parts do not
    depend on the operating point. If no operating point is found, the result is empty and a warning
    is printed.
    """
    scene = build.scene
    if not scene.analysis.is_small_signal or deck.text is not None or laws.is_linear:
        return OperatingPoint()
    # The probes are kept, because they determine the pins of a body. Probes of a noise analysis are
    # removed, because the run of the operating point has no noise results.
    probes = {} if build.has_noise else scene.probes
    frame = scene.frame.model_copy(update={"analysis": Analysis(type="op"), "probes": probes})
    # At the operating point, models are accurate up to the same frequency as in the small-signal
    # analysis: the end of its frequency range.
    # Each part therefore has the same pins and the same model, such as a model of eddy currents, at
    # the operating point and in the small-signal analysis.
    resolved = replace(scene, frame=frame, resolved_frequency=scene.analysis.stop)
    try:
        deck_at_rest = make_deck(rebuild_with_scene(build, resolved))
        with TemporaryDirectory() as folder:
            point: Waveforms = run_deck(deck_at_rest, Path(folder))
    except (SimulationError, UsageError) as error:
        warn_user(f"the operating point of {scene.name} is not known: {error.message}")
        return OperatingPoint()
    values = {name: float(point[name][-1]) for name in deck_at_rest.units if name in point}
    checks: list[Check] = []
    for part in scene.parts.values():
        checks += part.type.check_operating_point(part, build, point)
    units = {name: deck_at_rest.units[name] for name in values}
    return OperatingPoint(values, units, tuple(checks), point)
