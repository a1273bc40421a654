#!/bin/sh
# Makes a Debian or Ubuntu machine ready for kc2spice: ngspice with its shared library, the system
# libraries that the gmsh wheel loads, and a virtual environment with kc2spice in .venv.
# Installs only what is missing; a second run takes well under a second and needs no network.
set -eu

cd "$(dirname "$0")/.."
venv=.venv
stamp=$venv/.kc2spice-ready
# An activated environment of this checkout may have to be replaced: it must not replace itself.
PATH=$(printf ':%s:' "$PATH" | sed "s|:$PWD/$venv/bin:|:|g; s|^:||; s|:\$||")

say() { printf 'kc2spice setup: %s\n' "$*"; }
die() {
    printf 'kc2spice setup: %s\n' "$*" >&2
    exit 3
}

# First interpreter that is new enough; prints nothing where there is none.
find_python() {
    for candidate in python3 python3.14 python3.13 python3.12 python3.11; do
        if command -v "$candidate" >/dev/null 2>&1 &&
            "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v "$candidate"
            return
        fi
    done
}

# Debian's Python comes without ensurepip; the package is named after the interpreter's version.
venv_package() {
    "$1" -c 'import ensurepip, venv' 2>/dev/null && return
    "$1" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])'
}

# Debian package of each shared library that gmsh and the shared simulator need.
libraries='
libngspice.so.0 libngspice0
libGLU.so.1 libglu1-mesa
libGL.so.1 libgl1
libX11.so.6 libx11-6
libXext.so.6 libxext6
libXrender.so.1 libxrender1
libXcursor.so.1 libxcursor1
libXfixes.so.3 libxfixes3
libXft.so.2 libxft2
libXinerama.so.1 libxinerama1
libfontconfig.so.1 libfontconfig1
libgomp.so.1 libgomp1
libstdc++.so.6 libstdc++6
'

missing_packages() {
    command -v ngspice >/dev/null 2>&1 || echo ngspice
    # A slow test judges hostile netlists by the system calls that they cause.
    if [ "$(uname)" = Linux ]; then command -v strace >/dev/null 2>&1 || echo strace; fi
    # Elsewhere than on Linux the wheels bring their libraries along.
    known=$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null) || libraries=
    echo "$libraries" | while read -r soname package; do
        [ -z "$soname" ] && continue
        case $known in
        *"$soname"*) ;;
        *) echo "$package" ;;
        esac
    done
    python=$(find_python)
    if [ -n "$python" ]; then venv_package "$python"; else echo python3 python3-venv; fi
}

install_packages() {
    command -v apt-get >/dev/null 2>&1 ||
        die "no apt-get here; install by hand what provides: $*"
    root=
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null 2>&1 ||
            die "neither root nor sudo; ask your administrator to install: $*"
        root='sudo -n'
        $root true 2>/dev/null || root=sudo
    fi
    say "installing $*"
    # "env" because sudo drops the variables of its caller
    $root env DEBIAN_FRONTEND=noninteractive apt-get update -q
    # shellcheck disable=SC2086,SC2068
    $root env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends $@
}

packages=$(missing_packages | tr '\n' ' ')
if [ -n "$(echo "$packages" | tr -d ' ')" ]; then
    # shellcheck disable=SC2086
    install_packages $packages
fi
python=$(find_python)
[ -n "$python" ] || die "Python 3.11 or newer is needed; this system's packages have none"

# The stamp names the checkout, since a virtual environment does not survive a move.
if [ ! "$stamp" -nt pyproject.toml ] || [ "$(cat "$stamp")" != "$PWD" ]; then
    say "creating $venv with $($python --version)"
    rm -rf "$venv"
    "$python" -m venv "$venv"
    "$venv/bin/python" -m pip install --quiet --editable '.[test]'
    printf '%s\n' "$PWD" >"$stamp"
fi
