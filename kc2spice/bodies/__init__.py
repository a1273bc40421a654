"""Bodies: whatever becomes a linear model with named, typed ports."""
