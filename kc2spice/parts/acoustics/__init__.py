"""Parts of sound: radiation, listeners, cavities, vents and tubes."""
