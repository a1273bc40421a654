#!/bin/sh
# Unit and physics tests on the oldest and on the newest supported Python, each in a virtual
# environment of its own with the newest libraries that pip finds.
#
#   tools/pythons.sh [FOLDER]     default: $KC2SPICE_PYTHONS or ~/.cache/kc2spice-pythons
#
# Interpreters come from PATH and from pyenv; nothing is installed on the system. A version that
# this machine lacks, or whose libraries cannot be downloaded, is reported and skipped.
set -eu

cd "$(dirname "$0")/.."
root=${1:-${KC2SPICE_PYTHONS:-${XDG_CACHE_HOME:-$HOME/.cache}/kc2spice-pythons}}
oldest=11 # minor version of requires-python
newer=13  # lowest minor version that counts as new
highest=20
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"
say() { printf 'kc2spice pythons: %s\n' "$*"; }

# Prints the path of an interpreter 3.MINOR that can make virtual environments.
find_minor() { # MINOR
    for candidate in "python3.$1" "$HOME"/.pyenv/versions/3."$1"[.-]*/bin/python; do
        command -v "$candidate" >/dev/null 2>&1 || continue
        "$candidate" -c "import ensurepip, sys; sys.exit(sys.version_info[:2] != (3, $1))" \
            2>/dev/null || continue
        command -v "$candidate"
        return
    done
}

find_newest() {
    minor=$highest
    while [ "$minor" -ge "$newer" ]; do
        path=$(find_minor "$minor")
        if [ -n "$path" ]; then
            echo "$path"
            return
        fi
        minor=$((minor - 1))
    done
}

run_tests() { # NAME INTERPRETER
    environment=$root/$1
    "$2" -m venv "$environment"
    # --upgrade: an environment that exists gets today's newest versions too
    if ! "$environment/bin/python" -m pip install -qq --upgrade --upgrade-strategy eager \
        --editable '.[test]'; then
        say "no libraries for $2: its tests are skipped"
        return
    fi
    say "unit and physics tests with $2"
    PATH="$environment/bin:$PATH" "$environment/bin/python" -m pytest -q -n auto \
        -m "not slow" tests/unit tests/physics
}

found=$(find_minor "$oldest")
if [ -n "$found" ]; then
    run_tests oldest "$found"
else
    say "no Python 3.$oldest on this machine: the oldest supported version is not tested"
fi
found=$(find_newest)
if [ -n "$found" ]; then
    run_tests newest "$found"
else
    say "no Python 3.$newer or newer on this machine: newer versions are not tested"
fi
