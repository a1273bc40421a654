"""Part types that are declared by expressions for their energies, losses and states.

Netlists, laws of the independent integrator, and checks are generated from these expressions.
"""

from kc2spice.physics.declaration import Declaration as Declaration
from kc2spice.physics.declaration import branch as branch
from kc2spice.physics.declaration import current as current
from kc2spice.physics.declaration import displacement as displacement
from kc2spice.physics.declaration import loop as loop
from kc2spice.physics.declaration import measured as measured
from kc2spice.physics.declaration import voltage as voltage
from kc2spice.physics.part import DeclaredPart as DeclaredPart
