"""Own matrices: a chain of masses as a SPICE subcircuit with an error estimate."""

import numpy as np
from scipy.sparse import diags_array

import kc2spice as kc

n = 200
k, m = 4e6, 1e-6  # N/m and kg of each link
K = diags_array([np.full(n - 1, -k), np.full(n, 2 * k), np.full(n - 1, -k)], offsets=(-1, 0, 1))
M = diags_array([np.full(n, m)], offsets=[0])
B = np.zeros((n, 1))
B[n // 2] = 1.0  # a force in the middle; the displacement there is B' x

chain = kc.LinearModel(
    M=M, K=K, B=B, rayleigh=(0.0, 1e-8), ports=[kc.Port("middle", "mechanical")], name="chain"
)
rom = kc.reduce(chain, tolerance=1e-4, band=(0, 2e4))
print(rom)

frequency = np.linspace(100, 2e4, 50)
full, small = chain.transfer(frequency)[:, 0, 0], rom.transfer(frequency)[:, 0, 0]
assert np.abs(small - full).max() <= 1e-4 * np.abs(full).max()
assert rom.certificate.stable
assert rom.certificate.passive

part = kc.subcircuit(rom, "chain")
print(part)  # the pin "middle": 1 V is 1 um, 1 A is 1 N
part.write("chain.lib")
assert kc.read_lib("chain.lib")[0].pins == part.pins
