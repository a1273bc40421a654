"""Shared setup for squeezed films: a plate on its spring, driven far above the cut-off."""

# Three terms of the series of this film damp four times too much.
FILM = """
name = "film"
gravity = 0.0
[g]
part = "gap"
a = "m.a"
side = "above"
area = 8e-8
gap = "2 um"
travel = "1.4 um"
film = { length = "400 um", width = "200 um" }
pins = { plus = "v.out" }
[m]
part = "mass"
mass = "1 mg"
[s]
part = "spring"
stiffness = 100
pins = { a = "m.a" }
[sh]
part = "source"
kind = "force"
ac = "1 uN"
pins = { out = "m.a" }
[v]
part = "source"
[checks]
plausible = "off"
[analysis]
type = "ac"
start = "1.5 MHz"
stop = "3 MHz"
points = 3
"""
