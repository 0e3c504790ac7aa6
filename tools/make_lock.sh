#!/bin/sh
# Resolve requirements.in in an empty environment of Python 3.11 and write what was installed
# to requirements.lock; then ask the resolver of Python 3.12 whether the same versions do there.
set -eu

python312=${PYTHON312:-python3.12}
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
    echo "# For Python 3.11 and 3.12. The build of torch that pip finds brings its own libraries."
    sed -E -e 's/^(torch==[^+]+)\+.*/\1/' -e '/^(triton|cuda-|nvidia-([^m]|m[^l]))/d' "$work/installed"
} >"$work/lock"
cp "$work/lock" requirements.lock

if "$python312" -c '' 2>/dev/null; then
    "$python312" -m venv "$work/py312"
    "$work/py312/bin/python" -m pip install --dry-run --quiet -r requirements.lock
    echo "requirements.lock resolves on Python 3.12 as well."
else
    echo "No $python312 here: whether the lock does there remains to be checked." >&2
fi
