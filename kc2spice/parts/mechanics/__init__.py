"""Part types of masses, spheres, nonlinear springs and contacts."""
