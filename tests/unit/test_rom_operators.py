"""Norms and forms of operators at their edges."""

import numpy as np
import pytest
from scipy import sparse

from kc2spice.rom.operators import largest


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (3, 0)])
@pytest.mark.parametrize("make", [np.zeros, sparse.csc_array])
def test_the_largest_entry_of_no_entries_is_zero(make, shape):
    assert largest(make(shape)) == 0.0
