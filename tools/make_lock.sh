#!/bin/sh
# Resolve requirements.in in an empty environment of Python 3.11, write what was installed to
# requirements.lock and requirements-docs.lock, and check that the same versions can be installed with
# Python 3.12 and 3.13.
set -eu

work=$(mktemp -d)
trap 'rm -rf "$work" build' EXIT

"${PYTHON:-python3.11}" -m venv "$work/py311"
"$work/py311/bin/python" -m pip install -r requirements.in
"$work/py311/bin/python" -m pip freeze --all --exclude pip --exclude gaussian-photon-fields \
    >"$work/installed"

# Which build of torch is taken, and with it which CUDA libraries, is the installing
# machine's affair: neither a local version (+cpu) nor those libraries are locked.
{
    echo "# Made by \`make lock\` from requirements.in and pyproject.toml; not edited by hand."
    echo "# For Python 3.11 to 3.13. The build of torch that pip finds brings its own libraries."
    sed -E -e 's/^(torch==[^+]+)\+.*/\1/' -e '/^(triton|cuda-|nvidia-([^m]|m[^l]))/d' "$work/installed"
} >"$work/lock"
cp "$work/lock" requirements.lock

# The packages of `make docs` on top, without a change to any that is locked above.
"$work/py311/bin/python" -m pip install -c requirements.lock furo myst-nb sphinx
{
    echo "# Made by \`make lock\`: what \`make docs\` needs beside requirements.lock; not edited by hand."
    echo "# For Python 3.11 to 3.13."
    "$work/py311/bin/python" -m pip freeze --all --exclude pip --exclude gaussian-photon-fields |
        grep -vxFf "$work/installed"
} >requirements-docs.lock

for python in "${PYTHON312:-python3.12}" "${PYTHON313:-python3.13}"; do
    if "$python" -c '' 2>/dev/null; then
        "$python" -m venv --clear "$work/other"
        "$work/other/bin/python" -m pip install --dry-run --quiet -r requirements.lock -r requirements-docs.lock
        echo "Both locks can be installed with $("$python" --version) as well."
    else
        echo "No $python here: requirements.lock is not checked with it." >&2
    fi
done
