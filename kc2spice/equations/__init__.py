"""Laws of a scene, joined as its parts are. In goes a build, out come networks of laws in SI."""
