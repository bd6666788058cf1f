#!/usr/bin/env bash
# Degraded copies of every clip of a folder, one folder per kind; what exists is kept.
#
#   degrade.sh CLIPS OUT
#
#   half_rate  every second frame, lossless
#   half_size  half the width and height by area averages, lossless
#   crf28, crf35  x264 at that constant rate factor
set -euo pipefail
clips=$1
out=$2

# encode CLIP KIND SUFFIX ARGUMENT...: a copy appears whole or not at all.
encode() {
    local clip=$1 kind=$2 suffix=$3
    shift 3
    local name
    name=$(basename "$clip")
    local copy=$out/$kind/${name%.*}.$suffix
    [ -f "$copy" ] && return
    mkdir -p "$out/$kind" "$out/unfinished"
    local part=$out/unfinished/$kind.$suffix
    ffmpeg -nostdin -v error -y -i "$clip" -an -fps_mode passthrough -threads 1 "$@" "$part"
    mv "$part" "$copy"
}

for clip in "$clips"/*; do
    encode "$clip" half_rate mkv -vf "select=not(mod(n\,2))" -c:v ffv1
    encode "$clip" half_size mkv -vf "scale=trunc(iw/4)*2:trunc(ih/4)*2:flags=area" -c:v ffv1
    encode "$clip" crf28 mp4 -c:v libx264 -preset medium -pix_fmt yuv420p -crf 28
    encode "$clip" crf35 mp4 -c:v libx264 -preset medium -pix_fmt yuv420p -crf 35
done
