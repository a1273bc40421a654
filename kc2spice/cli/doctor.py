"""Checks of the programs and packages that kc2spice needs.

The result of a failed check contains the command that corrects the problem.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.metadata
import os
import platform
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from kc2spice.core import __version__
from kc2spice.core.cache import find_cache_dir
from kc2spice.core.errors import Kc2spiceError, MissingToolError
from kc2spice.core.install_commands import make_install_command
from kc2spice.netlist.deck import Deck
from kc2spice.sim.ngspice import find_ngspice, run_deck

_PYTHON_PACKAGES = (
    "numpy", "scipy", "cvxopt", "scikit-fem", "gmsh", "meshio", "PySpice", "matplotlib", "typer",
    "rich", "pydantic", "Jinja2", "typing_extensions",
)  # fmt: skip
# Shared libraries that the gmsh wheel loads, and the Debian and Ubuntu packages that contain them.
_GMSH_LIBRARIES = {
    "libGLU.so.1": "libglu1-mesa", "libGL.so.1": "libgl1", "libX11.so.6": "libx11-6",
    "libXext.so.6": "libxext6", "libXrender.so.1": "libxrender1", "libXcursor.so.1": "libxcursor1",
    "libXfixes.so.3": "libxfixes3", "libXft.so.2": "libxft2", "libXinerama.so.1": "libxinerama1",
    "libfontconfig.so.1": "libfontconfig1", "libgomp.so.1": "libgomp1",
}  # fmt: skip
# Test deck whose gain block requires XSPICE and its code models.
_XSPICE_DECK = """* code model probe
V1 in 0 DC 1
A1 in out probe
.model probe gain(gain=2)
R1 out 0 1
.op
.end
"""
# Test deck of the ngspice features that netlists of kc2spice use.
# The deck tests parameters in braces, ``pwl`` and ``max`` in a source, and a saved source current.
_FEATURE_DECK = """* feature probe
.param eps=2
V1 in 0 PULSE(0 1 0 1e-6 1e-6 1)
B1 0 out I={eps*max(0, V(in)-0.5)+pwl(V(in), 0, 0, 1, 3)}
R1 out 0 1
.options reltol=1e-4 trtol=1 chgtol=1e-8 method=trap pivrel=0.1
.tran 1e-6 1e-5
.save v(out)
.save @b1[i]
.end
"""
# Name of the feature, test deck, vectors, expected last value of each vector, and remedy.
_FEATURE_TESTS = (
    ("ngspice runs a test netlist", _FEATURE_DECK, ("v(out)", "@b1[i]"), 4.0,
     "install a complete ngspice, version 39 or later"),
    ("XSPICE code models", _XSPICE_DECK, ("v(out)",), 2.0,
     "reinstall ngspice; its code models (*.cm) or its spinit file are missing"),
)  # fmt: skip


@dataclass(frozen=True)
class InstallationFinding:
    """Result of one check of the installation, with the command that fixes a problem.

    ``fix`` is the command that corrects the problem, empty if the check passes. kc2spice cannot run
    if a ``needed`` check fails. ``package`` is true for a check of a Python package.
    """

    name: str
    ok: bool
    state: str
    fix: str = ""
    needed: bool = True
    package: bool = False


def describe_program() -> str:
    """Return the versions of kc2spice and Python, and the platform, for bug reports."""
    python = platform.python_version()
    return f"kc2spice {__version__} on Python {python}, {platform.system()} {platform.machine()}"


def check_installation() -> Iterator[InstallationFinding]:
    """Yield the result of each check of the installation, checks of ngspice first."""
    yield from _check_ngspice()
    name = ctypes.util.find_library("ngspice")
    ok = name is not None and _can_load_library(name)
    fix = "" if ok else make_install_command("libngspice0")
    yield InstallationFinding("libngspice", ok, name or "not found", fix, needed=ok)
    version = ".".join(map(str, sys.version_info[:3]))
    yield InstallationFinding(
        "Python", sys.version_info >= (3, 11), version, "install Python 3.11 or newer"
    )
    for library in _PYTHON_PACKAGES:
        try:
            version = importlib.metadata.version(library)
            yield InstallationFinding(library, True, version, package=True)
        except importlib.metadata.PackageNotFoundError:
            fix = f"{sys.executable} -m pip install {library}"
            yield InstallationFinding(library, False, "not installed", fix, package=True)
    if sys.platform == "linux":
        missing = [soname for soname in _GMSH_LIBRARIES if not _can_load_library(soname)]
        result = "missing " + ", ".join(missing) if missing else f"all {len(_GMSH_LIBRARIES)} found"
        fix = make_install_command(*(_GMSH_LIBRARIES[item] for item in missing)) if missing else ""
        yield InstallationFinding("system libraries of gmsh", not missing, result, fix)
    folder = find_cache_dir()
    existing = next(filter(os.path.exists, (folder, *folder.parents)))
    ok = os.path.isdir(existing) and os.access(existing, os.W_OK | os.X_OK)
    fix = "set KC2SPICE_CACHE to a directory that you can write to"
    yield InstallationFinding(
        "cache", ok, f"{folder}{'' if ok else ' cannot be written'}", fix, needed=False
    )


def _can_load_library(soname: str) -> bool:
    """Return whether the shared library ``soname`` can be loaded."""
    try:
        return bool(ctypes.CDLL(soname))
    except OSError:
        return False


def _check_ngspice() -> Iterator[InstallationFinding]:
    """Check the ngspice program, the features that kc2spice uses, and the code models."""
    find_ngspice.cache_clear()
    install, missing = make_install_command("ngspice"), None
    try:
        result = find_ngspice()
        yield InstallationFinding("ngspice", True, f"{result.version} ({result.path})")
    except MissingToolError as error:
        missing = error
        yield InstallationFinding("ngspice", False, f"{error.message} ({error.where})", install)
    for name, text, vectors, expected, fix in _FEATURE_TESTS:
        ok, outcome, needed = False, "no ngspice", text == _FEATURE_DECK
        if missing is None:
            deck = Deck(name="probe", text=text, vectors={k: (k, 1.0) for k in vectors})
            with tempfile.TemporaryDirectory() as folder:
                try:
                    waves = run_deck(deck, Path(folder), timeout=20)
                    ends = [float(abs(waves[vector][-1])) for vector in vectors]
                    ok = all(abs(end - expected) < 1e-6 for end in ends)
                    outcome = "passed" if ok else f"got {ends}"
                except Kc2spiceError as error:
                    outcome = error.message
        yield InstallationFinding(name, ok, outcome, fix if missing is None else install, needed)
