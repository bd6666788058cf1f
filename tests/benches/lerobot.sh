#!/usr/bin/env bash
# Whether LeRobot and Plumbline read each other: lerobot itself writes a dataset of CLIPS (one episode each, all of
# one size), `plumbline score` reads it, and lerobot loads the kept episodes, deletes the dropped ones and joins the
# frame rewards to its own frames. Ends with an error where they do not agree.
#
#   LEROBOT_PYTHON=PYTHON tests/benches/lerobot.sh CLIP CLIP...
#
# PYTHON has lerobot (0.3 writes version 2.1 datasets, 0.4 writes 3.0), av and torch; any torch that lerobot imports.
# PLUMBLINE names a built command (default: built here).
set -euo pipefail
cd "$(dirname "$0")/../.."
python=${LEROBOT_PYTHON:?name an interpreter that has lerobot}
plumbline=${PLUMBLINE:-}
if [ -z "$plumbline" ]; then
    cargo build --release --locked --workspace --bin plumbline
    plumbline=${CARGO_TARGET_DIR:-target}/release/plumbline
fi
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT

"$python" -W ignore tests/benches/lerobot_peer.py write "$work/dataset" "$@" 2>"$work/log" || { cat "$work/log" >&2; exit 1; }
"$plumbline" score "$work/dataset" --out "$work/out" --keep 50% --profile draft --format jsonl --recipe paper
"$python" -W ignore tests/benches/lerobot_peer.py read "$work/dataset" "$work/out" "$work/kept" 2>"$work/log" || { cat "$work/log" >&2; exit 1; }
