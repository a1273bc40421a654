"""Norms of the error of a reduced model, in words, and the smallest divisor of an error."""

# Smallest value by which the norm ``pointwise`` divides the error of an entry of the response, as a
# share of the entry's peak. At the notches of a response, the error relative to the value of the
# notch would have no limit.
PEAK_SHARE = 1e-6
# What an error is relative to, keyed by norm.
NORM_WORDS = {
    "pointwise": "the response at each frequency or "
    + f"{PEAK_SHARE:.0e}".replace("e-0", "e-")
    + " of its peak, whichever is larger",
    "peak": "the largest response in the band",
}
