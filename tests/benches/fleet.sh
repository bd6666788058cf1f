#!/usr/bin/env bash
# What a fleet costs beside its work, on this machine with a private broker and store: no-op jobs per second
# from publishing to collecting, beside Celery on the same broker; how busy slots are with jobs of 50 ms; one
# worker against two on real clips. Writes a dated table to tests/benches/results/. Takes less than 10 minutes.
#
#   fleet.sh
#
# CELERY names an environment's bin directory that holds celery 5.7 (default: a new one, from PyPI);
# PLUMBLINE and WORKER the commands (default: built).
set -euo pipefail
cd "$(dirname "$0")/../.."
if [ -z "${PLUMBLINE_TEST_BROKER_DIR:-}" ] || [ -z "${PLUMBLINE_TEST_STORE_DIR:-}" ]; then
    exec deploy/servers.sh "$0"
fi
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
if [ -z "${PLUMBLINE:-}" ] || [ -z "${WORKER:-}" ]; then
    cargo build --release -q --bin plumbline --bin plumbline-worker
    export PLUMBLINE=${CARGO_TARGET_DIR:-$PWD/target}/release/plumbline
    export WORKER=${CARGO_TARGET_DIR:-$PWD/target}/release/plumbline-worker
fi
if [ -z "${CELERY:-}" ]; then
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" install -q 'celery==5.7.*'
    export CELERY=$work/venv/bin
fi
mkdir -p tests/benches/results
result=tests/benches/results/fleet-$(date +%F).md
commit=$(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker coordinator common || echo ' with changes')
python3 -B tests/benches/fleet.py "$work" "$commit" >"$work/result.md"
mv "$work/result.md" "$result"
cat "$result"
