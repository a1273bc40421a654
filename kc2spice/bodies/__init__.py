"""Bodies: each module turns a parametric device into a LinearModel with named, typed ports."""
