#!/bin/sh
# Writes requirements.lock (what runs) and requirements-dev.lock (what tests) from the ranges in pyproject.toml.
set -eu
python=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for set in "" dev; do
    "$python" -m venv "$work/venv$set"
    "$work/venv$set/bin/pip" install --quiet ".${set:+[$set]}"
    file=requirements${set:+-$set}.lock
    echo "# made by make lock; versions that were tested together" > "$file"
    "$work/venv$set/bin/pip" freeze --exclude anisoscope >> "$file"
done
