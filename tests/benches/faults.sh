#!/usr/bin/env bash
# Fault detectors on clips with known faults: tables with intervals, written to
# tests/benches/results/faults-DATE.md. Needs ffmpeg and the real clips of ../shared/data.
#
#   faults.sh [EVERY=1]    every EVERYth held-out clip
set -euo pipefail
cd "$(dirname "$0")/../.."
every=${1:-1}

run() { cargo run -q --release -p plumbline-vision --example injected_faults -- "$@"; }

mkdir -p tests/benches/results
result=tests/benches/results/faults-$(date +%F).md
# What was written below the tables stays.
notes=$(sed -n '/^## What limits it/,$p' "$result" 2>/dev/null || true)
{
    echo "# Fault detectors on known faults: $(date +%F)"
    echo
    echo "- machine: $(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) cores, $(uname -sr), load $(cut -d' ' -f1 /proc/loadavg)"
    echo "- commit $(git rev-parse --short HEAD)$(git diff --quiet HEAD -- worker/vision || echo ' with changes'); command: tests/benches/faults.sh $every"
    echo "- recorded clips of static cameras, 26 frames from the middle, 256 px high, profile standard; halves by a hash of the file name, seed of an injection = that hash + the kind's number"
    echo "- hit: worst frame within one frame of the fault; pointing: its peak within one cell of the fault's cells; TPR: worst score above the shipped threshold; any event: of any kind, within one frame; 95% intervals: 2000 bootstraps over clips"
    echo "- evidence: \`evidence.md\`, section 4, on other clips (34 of two sources; vanish on 61)"
    echo
    run fit
    echo
    run real "$every"
    echo
    run sample
    echo
    echo "$notes"
} >"$result"
echo "$result"
