"""The usual code of contact with a full model: what the figures of `make bench` compare with."""
