"""Part types that are declared by their energies, losses and states.

From the expressions of energies, losses and states, the program generates netlists, checks, and the
equations for the independent integrator.
"""

from kc2spice.physics.declaration import Declaration as Declaration
from kc2spice.physics.declaration import branch as branch
from kc2spice.physics.declaration import current as current
from kc2spice.physics.declaration import displacement as displacement
from kc2spice.physics.declaration import loop as loop
from kc2spice.physics.declaration import measured as measured
from kc2spice.physics.declaration import voltage as voltage
from kc2spice.physics.part import DeclaredPart as DeclaredPart
