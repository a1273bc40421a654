"""Shell commands that install programs on the operating system in use.

The arguments of :func:`make_install_command` are names of Debian packages. The function returns a
shell command, or an instruction in words if the package manager is unknown. Commands for Fedora,
macOS and Windows are not tested.
"""

from __future__ import annotations

import sys
from pathlib import Path

_OS_RELEASE = Path("/etc/os-release")
# First words of the install command, keyed by the field ID or ID_LIKE of /etc/os-release, or by
# sys.platform.
_INSTALL_COMMANDS = {
    "debian": "apt-get install",
    "ubuntu": "apt-get install",
    "fedora": "dnf install",
    "rhel": "dnf install",
    "centos": "dnf install",
    "darwin": "brew install",
    "win32": "scoop bucket add extras; scoop install",  # the bucket "extras" contains ngspice
}
# Package names on other systems, keyed by install command and by name of the Debian package.
# On macOS and Windows, the gmsh wheel contains all libraries that gmsh loads.
_PACKAGE_NAMES = {
    _INSTALL_COMMANDS["fedora"]: {
        "ngspice": "ngspice",
        "libngspice0": "libngspice",
        "libglu1-mesa": "mesa-libGLU",
        "libgl1": "libglvnd-glx",
        "libx11-6": "libX11",
        "libxext6": "libXext",
        "libxrender1": "libXrender",
        "libxcursor1": "libXcursor",
        "libxfixes3": "libXfixes",
        "libxft2": "libXft",
        "libxinerama1": "libXinerama",
        "libfontconfig1": "fontconfig",
        "libgomp1": "libgomp",
    },
    _INSTALL_COMMANDS["darwin"]: {"ngspice": "ngspice", "libngspice0": "libngspice"},
    _INSTALL_COMMANDS["win32"]: {"ngspice": "ngspice"},
}


def make_install_command(*packages: str) -> str:
    """Return the shell command that installs the given packages on this system.

    Parameters
    ----------
    packages : str
        Names of Debian packages, such as ``"ngspice"``.

    Returns
    -------
    str
        Command for apt-get, dnf, brew or scoop. If the package names on this system are unknown,
        the result is a sentence with the Debian names.

    Examples
    --------
    >>> make_install_command("ngspice").endswith("ngspice")
    True
    """
    command = _find_command(sys.platform, _read_os_release())
    names = _PACKAGE_NAMES.get(command, {})
    if command == _INSTALL_COMMANDS["debian"]:
        names = dict(zip(packages, packages, strict=True))
    if set(packages) <= set(names):
        return " ".join((command, *map(names.__getitem__, packages)))
    return f"install the package that Debian calls {', '.join(packages)}"


def _find_command(platform: str, release: str) -> str:
    """Find the install command of the operating system; empty for an unknown system."""
    systems = [platform]
    if platform == "linux":
        fields = dict(line.split("=", 1) for line in release.splitlines() if "=" in line)
        systems = f"{fields.get('ID', '')} {fields.get('ID_LIKE', '')}".replace('"', "").split()
    return next(filter(None, map(_INSTALL_COMMANDS.get, systems)), "")


def _read_os_release() -> str:
    """Return the text of /etc/os-release; empty if the file does not exist."""
    try:
        return _OS_RELEASE.read_text(encoding="utf-8")
    except OSError:
        return ""
