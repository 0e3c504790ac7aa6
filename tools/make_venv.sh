#!/bin/sh
# Make .venv with a Python that fits: $PYTHON if it is set, else the first of the usual names.
set -eu

set -- ${PYTHON:+"$PYTHON"}
[ $# -gt 0 ] || set -- python3.11 python3.12 python3.13 python3
without_venv=
for python in "$@"; do
    # Run it: a name on the PATH may be a launcher for a version that is not installed.
    "$python" -c 'import sys; sys.exit(sys.version_info[:2] not in ((3, 11), (3, 12), (3, 13)))' \
        2>/dev/null || continue
    if "$python" -c 'import ensurepip, venv' 2>/dev/null; then
        echo "Making .venv with $("$python" --version) ($python)"
        exec "$python" -m venv --clear .venv
    fi
    without_venv=$python
done

if [ -n "$without_venv" ]; then
    version=$("$without_venv" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
    echo "$without_venv cannot make virtual environments: its venv or ensurepip module is missing." >&2
    echo "On Debian and Ubuntu: sudo apt install $version-venv" >&2
else
    echo "No Python 3.11, 3.12 or 3.13 that works among: $*" >&2
    echo "Install one, or name it: make PYTHON=/path/to/python3.12 ..." >&2
fi
exit 2
