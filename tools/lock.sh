#!/bin/sh
# Writes requirements-dev.lock (what tests) and requirements.lock (what runs, in the versions that are tested) from the
# ranges in pyproject.toml: the newest versions, each with the hashes of all its files, whatever the platform. pip then
# takes no other file.
set -eu
python=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m venv "$work/venv"
"$work/venv/bin/pip" install --quiet uv # unlike pip it reads hashes from the index, without downloading the files
for set in dev ""; do
    file=requirements${set:+-$set}.lock
    what=${set:+--extra $set}
    run="--extra view --extra formats" # of what runs, make demo installs these extras
    # what runs is locked after what tests, and in its versions
    "$work/venv/bin/uv" pip compile --quiet --upgrade --python "$python" --generate-hashes --strip-extras \
        --no-header --no-annotate --no-emit-index-url --no-emit-find-links \
        ${what:---constraint requirements-dev.lock $run} --output-file "$work/$file" pyproject.toml
    { echo "# made by make lock; versions that were tested together"; cat "$work/$file"; } > "$file"
done
