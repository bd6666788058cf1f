#!/usr/bin/env bash
# Sets up, renders the sample corpus, scores it, and says where the report is.
# Usage: deploy/demo.sh [DIR]     (default: ./out/demo)
. "$(dirname "${BASH_SOURCE[0]}")/common.sh"

out=${1:-$root/out/demo}
setup_build
say "building"
cargo build --release --locked --bin plumbline
plumbline=${CARGO_TARGET_DIR:-$root/target}/release/plumbline

say "rendering the sample: 24 robot clips, half of them with a known fault"
"$plumbline" sample --out "$out/sample"

say "scoring it"
# Exit code 3 says that some rows have no score: clips with a frame of noise or blur are such rows.
"$plumbline" score "$out/sample/videos" --out "$out/scores" --group-by prefix:__ || [ $? -eq 3 ]

say "done: open $out/scores/report.html"
