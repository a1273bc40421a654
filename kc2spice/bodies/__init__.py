"""Bodies: devices as linear models with named ports, from sizes, meshes or files."""
